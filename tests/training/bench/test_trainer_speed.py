"""What is compared when the trainer's speed is measured; how fast it is, no test says."""

from __future__ import annotations

import sys

import pytest
import torch

from cdcsr.robot.description import load_robot
from training.bench import trainer_speed as bench
from training.config.run_config import Learner
from training.networks.bfloat16 import has_fast_bfloat16


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
    kinds = ("", "_bfloat16") if has_fast_bfloat16() else ("",)
    # A turn to warm up, and one that is measured.
    assert done == dict.fromkeys([name + kind for name in bench.OWN for kind in kinds], 4)
    assert (speed["bfloat16"] is not None) == ("_bfloat16" in kinds)
    for name in bench.OWN:
        theirs, ours = (
            speed["stable_baselines3_updates_per_second"],
            speed["updates_per_second"][name],
        )
        assert speed["ratio"][name] == pytest.approx(ours / theirs)


def test_the_speed_of_the_others_in_bfloat16_is_taken_in_bfloat16(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []
    run = bench._in_bfloat16(
        lambda count: seen.append((count, torch.get_float32_matmul_precision()))
    )
    run(3)
    assert seen == [(3, "medium")]
    assert torch.get_float32_matmul_precision() == "highest"
    kinds: list[bool] = []
    monkeypatch.setitem(bench.ALGORITHMS, "batd3", lambda *given: kinds.append(given[1].bfloat16))
    for bfloat16 in (True, False):
        bench.own_updates("batd3", bfloat16)
    assert kinds == [True, False]


def test_speeds_by_hand() -> None:
    times = {
        "batd3": 0.020,
        "td3": 0.016,
        "clasp": 0.010,
        "stable_baselines3": 0.030,
        "product": 0.005,
        "sbx": 0.040,
    }
    plain = bench.speeds(times, 1e9)
    assert plain["ratio"] == pytest.approx({"batd3": 1.5, "td3": 1.875, "clasp": 3.0})
    assert plain["sbx_ratio"] == pytest.approx({"batd3": 2.0, "td3": 2.5, "clasp": 4.0})
    assert plain["product_gflops"] == pytest.approx(50 * 2 * 256**3 / 0.005 / 1e9)
    assert plain["share_of_product_rate"] == pytest.approx(1 / 0.020 / plain["product_gflops"])
    assert plain["bfloat16"] is None
    fast = {
        "batd3": 0.010,
        "td3": 0.004,
        "clasp": 0.005,
        "stable_baselines3": 0.012,
        "product": 0.001,
    }
    both = bench.speeds(times | {f"{name}_bfloat16": time for name, time in fast.items()}, 1e9)
    assert {name: both[name] for name in plain if name != "bfloat16"} == {
        name: value for name, value in plain.items() if name != "bfloat16"
    }
    found = both["bfloat16"]
    assert found["updates_per_second"] == pytest.approx({"batd3": 100, "td3": 250, "clasp": 200})
    assert found["ratio"] == pytest.approx({"batd3": 3.0, "td3": 7.5, "clasp": 6.0})
    assert found["sbx_ratio"] == pytest.approx({"batd3": 4.0, "td3": 10.0, "clasp": 8.0})
    assert found["like_for_like"] == pytest.approx({"batd3": 1.2, "td3": 3.0, "clasp": 2.4})
    assert found["stable_baselines3_updates_per_second"] == pytest.approx(1 / 0.012)
    assert found["share_of_product_rate"] == pytest.approx(2 * plain["share_of_product_rate"])
    assert found["share_of_own_product_rate"] == pytest.approx(
        2 / 5 * plain["share_of_product_rate"]
    )
    del times["sbx"]
    assert bench.speeds(times, 1e9)["sbx_ratio"] == dict.fromkeys(bench.OWN)


def test_operations_of_an_update_are_those_of_its_matrix_products() -> None:
    # By hand, of the paper's sizes: 31 numbers seen, 8 cables, three layers of 256.
    actor, critic = 31 * 256 + 2 * 256**2 + 256 * 8, 39 * 256 + 2 * 256**2 + 256
    target = actor + 2 * 2 * critic
    critics = 5 * (3 * critic - 39 * 256)
    improve = (3 * actor - 31 * 256 + 2 * 2 * critic) / 2
    assert bench.update_flops(Learner(), load_robot("paper")) == pytest.approx(
        2 * 256 * (target + critics + improve)
    )
