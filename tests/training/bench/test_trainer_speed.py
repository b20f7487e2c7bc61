"""The trainer's speed: the same updates are compared, whatever the machine."""

from __future__ import annotations

import sys

import pytest
import torch

from cdcsr.robot.description import Robot
from training.algorithms.batd3 import BATD3, BATD3Numbers
from training.algorithms.registry import ALGORITHMS, Algorithm
from training.bench import timed_updates, trainer_speed
from training.bench.timed_updates import Updates, update_flops
from training.bench.trainer_speed import (
    BFLOAT16,
    TIMED,
    compare_speeds,
    in_bfloat16,
    update_seconds,
)
from training.networks.bfloat16 import has_fast_bfloat16


def test_every_learner_makes_the_same_number_of_updates(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: dict[str, int] = {}
    built = timed_updates.own_updates

    def counted(name: str, bfloat16: bool = False) -> Updates:
        run, kind = built(name, bfloat16), name + BFLOAT16 * bfloat16

        def count(updates: int) -> None:
            done[kind] = done.get(kind, 0) + updates
            run(updates)

        return count

    monkeypatch.setattr(trainer_speed, "own_updates", counted)
    seconds = update_seconds(paper, sys.executable, updates=2, rounds=1)
    kinds = ("", BFLOAT16) if has_fast_bfloat16() else ("",)
    # One turn warms up, and one is measured.
    assert done == dict.fromkeys([name + kind for name in TIMED for kind in kinds], 4)
    names = {name + kind for name in (*TIMED, "stable_baselines3", "product") for kind in kinds}
    assert seconds.keys() - {"sbx"} == names
    assert all(value > 0 for value in seconds.values())


def test_the_speed_of_the_others_in_bfloat16_is_taken_in_bfloat16(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []
    run = in_bfloat16(lambda count: seen.append((count, torch.get_float32_matmul_precision())))
    run(3)
    assert seen == [(3, "medium")]
    assert torch.get_float32_matmul_precision() == "highest"
    kinds: list[bool] = []

    class Seen(BATD3):
        def __init__(self, *given: BATD3Numbers) -> None:
            kinds.append(given[1].bfloat16)

    monkeypatch.setitem(ALGORITHMS, "batd3", Algorithm("BATD3", "", BATD3Numbers, Seen))
    for bfloat16 in (True, False):
        timed_updates.own_updates("batd3", bfloat16)
    assert kinds == [True, False]


FLOAT32 = {
    "batd3": 0.020,
    "td3": 0.016,
    "clasp": 0.010,
    "stable_baselines3": 0.030,
    "product": 0.005,
    "sbx": 0.040,
}
"""Seconds an update."""
FAST = {"batd3": 0.010, "td3": 0.004, "clasp": 0.005, "stable_baselines3": 0.012, "product": 0.001}
"""The same in bfloat16."""
RATE = 50 * 2 * 256**3 / 0.005
"""The rate of the products in float32, in operations a second."""


def compared(seconds: dict[str, float]) -> dict[str, float | None]:
    return {row.name: row.value for row in compare_speeds(seconds, 1e9)}


def test_speeds_in_float32_by_hand() -> None:
    found = compared(FLOAT32)
    assert found.pop("update_share_bfloat16") is None
    names = [f"update_{peer}_{name}" for peer in ("sb3", "sbx") for name in TIMED]
    speeds = dict(zip(names, (1.5, 1.875, 3.0, 2.0, 2.5, 4.0), strict=True))
    assert found == pytest.approx({"update_share": 1e9 / 0.020 / RATE, **speeds})
    without = compared({name: value for name, value in FLOAT32.items() if name != "sbx"})
    assert [without[f"update_sbx_{name}"] for name in TIMED] == [None] * 3


def test_speeds_in_bfloat16_by_hand() -> None:
    found = compared(FLOAT32 | {name + BFLOAT16: value for name, value in FAST.items()})
    plain = compared(FLOAT32)
    del plain["update_share_bfloat16"]
    assert {name: found.pop(name) for name in plain} == plain
    assert found == pytest.approx(
        {
            "update_share_bfloat16": 1e9 / 0.010 / RATE,
            "update_sb3_batd3_bfloat16": 3.0,
            "update_sb3_td3_bfloat16": 7.5,
            "update_sb3_clasp_bfloat16": 6.0,
            "update_sbx_batd3_bfloat16": 4.0,
            "update_sbx_td3_bfloat16": 10.0,
            "update_sbx_clasp_bfloat16": 8.0,
            "update_share_bfloat16_alike": 1e9 / 0.010 / (5 * RATE),
            "update_sb3_batd3_bfloat16_alike": 1.2,
            "update_sb3_td3_bfloat16_alike": 3.0,
            "update_sb3_clasp_bfloat16_alike": 2.4,
        }
    )


def test_operations_of_an_update_are_those_of_its_matrix_products(paper: Robot) -> None:
    # By hand, for the paper's sizes: 31 inputs, 8 cables, three layers of 256.
    actor, critic = 31 * 256 + 2 * 256**2 + 256 * 8, 39 * 256 + 2 * 256**2 + 256
    target = actor + 2 * 2 * critic
    critics = 5 * (3 * critic - 39 * 256)
    improve = (3 * actor - 31 * 256 + 2 * 2 * critic) / 2
    expected = 2 * 256 * (target + critics + improve)
    assert update_flops(BATD3Numbers(), paper) == pytest.approx(expected)
