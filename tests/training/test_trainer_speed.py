"""What is compared when the trainer's speed is measured; how fast it is, no test says."""

from __future__ import annotations

import sys

import pytest

from cdcsr.robot import load_robot
from training import bench
from training.config import Learner
from training.precision import bfloat16_products


def test_every_speed_is_a_ratio_of_the_same_updates(monkeypatch: pytest.MonkeyPatch) -> None:
    done: dict[str, int] = {}
    built = bench.own_updates

    def counted(name: str, bfloat16: bool = False) -> object:
        run, kind = built(name, bfloat16), name + "_bfloat16" * bfloat16

        def count(updates: int) -> None:
            done[kind] = done.get(kind, 0) + updates
            run(updates)

        return count

    monkeypatch.setattr(bench, "own_updates", counted)
    speed = bench.update_speed(sys.executable, updates=2, rounds=1)
    kinds = ("", "_bfloat16") if bfloat16_products() else ("",)
    # A turn to warm up, and one that is measured.
    assert done == dict.fromkeys([name + kind for name in bench.OWN for kind in kinds], 4)
    assert (speed["bfloat16"] is not None) == ("_bfloat16" in kinds)
    for name in bench.OWN:
        theirs, ours = speed["stable_baselines3_updates_per_second"], speed["updates_per_second"][name]
        assert speed["ratio"][name] == pytest.approx(ours / theirs)
        if speed["sbx_updates_per_second"] is None:
            assert speed["sbx_ratio"][name] is None
        else:
            assert speed["sbx_ratio"][name] == pytest.approx(ours / speed["sbx_updates_per_second"])
    assert speed["share_of_product_rate"] > 0


def test_operations_of_an_update_are_those_of_its_matrix_products() -> None:
    # By hand, of the paper's sizes: 31 numbers seen, 8 cables, three layers of 256.
    actor, critic = 31 * 256 + 2 * 256**2 + 256 * 8, 39 * 256 + 2 * 256**2 + 256
    target = actor + 2 * 2 * critic
    critics = 5 * (3 * critic - 39 * 256)
    improve = (3 * actor - 31 * 256 + 2 * 2 * critic) / 2
    assert bench.update_flops(Learner(), load_robot("paper")) == pytest.approx(2 * 256 * (target + critics + improve))
