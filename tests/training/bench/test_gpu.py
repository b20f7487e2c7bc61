"""The measurements on a GPU, in small and on a processor."""

from __future__ import annotations

import pytest
import torch

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from training.bench.gpu import Extent, gpu

PAPER = load_robot("paper")


def test_every_row_is_measured() -> None:
    small = {"num_envs": 4, "batch_size": 32, "hidden": (16,), "bc_updates": 100, "bc_rollouts": 2}
    small["capacity"] = 10_000
    extent = Extent(
        engine="mujoco",
        copies=(2, 4),
        peer_copies=4,
        steps=5,
        seeds=2,
        reach_minutes=0.0,
        capture_minutes=0.0,
        changes=tuple(small.items()),
        evaluate_every=4,
        evaluate_episodes=2,
        methods=("td3", "her"),
        spaces=1,
    )
    rows = {row.name: row for row in gpu(PAPER, torch.device("cpu"), extent)}
    assert rows["gpu_name"].details["gpu_versions"]
    for name, row in rows.items():
        if name == "gpu_name" or row.name.startswith(("gpu_reach", "gpu_capture")):
            continue
        assert row.value is not None
        assert row.value > 0
    ratio = rows["gpu_step_2"].value / rows["gpu_step_1"].value  # type: ignore[operator]
    assert rows["gpu_seeds_over_one"].value == pytest.approx(ratio)
    grid = [rows[f"gpu_grid_{name}"].value for name in extent.methods]
    assert rows["gpu_grid"].value == pytest.approx(sum(grid))  # type: ignore[arg-type]
    assert rows["gpu_reach_0.95"].details["gpu_reach_curve"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_nothing_is_measured() -> None:
    with pytest.raises(CdcsrError, match="finds no GPU"):
        next(gpu(PAPER, torch.device("cuda")))
