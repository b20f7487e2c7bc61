"""The picture of targets: reached and missed ones are found in it again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from tests.support.pixels import count_pixels
from training.measure.evaluation import Result
from training.plots.targets import MISSED_COLOR, REACHED_COLOR, draw_targets


def results(reached: int, total: int = 20) -> Result:
    rng = np.random.default_rng(0)
    success = np.arange(total) < reached
    targets = rng.normal((0.2, 0.1, 2.4), 0.1, (total, 3))
    return Result(success, np.full(total, 100), np.zeros(total), targets)


def test_reached_and_missed_targets_differ(tmp_path: Path) -> None:
    robot = load_robot("paper")
    reds, greens = [], []
    for reached in (20, 10, 0):
        path = tmp_path / f"{reached}.png"
        panels = {"BC in MuJoCo": results(reached), "BC in PyBullet": results(reached)}
        draw_targets(panels, robot, path)
        reds.append(count_pixels(path, MISSED_COLOR))
        greens.append(count_pixels(path, REACHED_COLOR))
    assert reds[0] < reds[1] < reds[2]
    assert greens[0] > greens[1] > greens[2]


def test_one_target_and_another_robot(tmp_path: Path) -> None:
    draw_targets({"one": results(1, total=1)}, load_robot("planar-single"), tmp_path / "one.png")
    assert count_pixels(tmp_path / "one.png", REACHED_COLOR) > 0


def test_no_results_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="no results"):
        draw_targets({}, load_robot("paper"), tmp_path / "none.png")
