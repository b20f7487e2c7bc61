"""Figures: what is drawn can be found in the picture again."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import ImageColor

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from training.measure.evaluation import Result, wilson
from training.plots.run_plots import MISSED_COLOR, REACHED_COLOR, learning_curve, targets_picture
from training.run.metrics import Metrics


def count(path: Path, color: str) -> int:
    """Pixels of exactly one colour."""
    picture: NDArray[np.uint8] = imageio.imread(path)[..., :3]
    return int((picture == ImageColor.getrgb(color)).all(axis=2).sum())


def results(reached: int, total: int = 20) -> Result:
    rng = np.random.default_rng(0)
    success = np.arange(total) < reached
    return Result(
        success, np.full(total, 100), np.zeros(total), rng.normal((0.2, 0.1, 2.4), 0.1, (total, 3))
    )


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with metrics of three evaluations."""
    folder = tmp_path / "run"
    folder.mkdir()
    metrics = Metrics(folder, 0)
    for update, successes in ((1000, 5), (2000, 50), (3000, 90)):
        low, high = wilson(successes, 100)
        metrics.add(
            {
                "update": update,
                "environment_steps": 64 * update,
                "minutes": update / 1000,
                "success_rate": successes / 100,
                "success_low": low,
                "success_high": high,
            }
        )
    metrics.close()
    return folder


def test_learning_curve_shows_every_run(run: Path, tmp_path: Path) -> None:
    learning_curve([run], tmp_path / "one.png")
    learning_curve([run, run.parent / "empty"], tmp_path / "same.png", {"BC": 0.7})
    assert count(tmp_path / "one.png", "#1f5fa8") > 500
    assert (tmp_path / "one.png").read_bytes() != (tmp_path / "same.png").read_bytes()
    height, width, _ = imageio.imread(tmp_path / "one.png").shape
    assert 400 < height < width < 1400


def test_learning_curve_is_the_same_each_time(run: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        learning_curve([run], tmp_path / name, {"BC": 0.7, "demonstrator": 0.93})
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_learning_curve_without_metrics(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"No run has metrics to draw yet: .*nothing"):
        learning_curve([tmp_path / "nothing"], tmp_path / "curve.png")
    assert not (tmp_path / "curve.png").exists()


def test_targets_picture_tells_reached_from_missed(tmp_path: Path) -> None:
    robot = load_robot("paper")
    reds, greens = [], []
    for reached in (20, 10, 0):
        path = tmp_path / f"{reached}.png"
        targets_picture(
            {"BC in MuJoCo": results(reached), "BC in PyBullet": results(reached)}, robot, path
        )
        reds.append(count(path, MISSED_COLOR))
        greens.append(count(path, REACHED_COLOR))
    assert reds[0] < reds[1] < reds[2]
    assert greens[0] > greens[1] > greens[2]


def test_targets_picture_of_one_target_and_another_robot(tmp_path: Path) -> None:
    targets_picture({"one": results(1, total=1)}, load_robot("planar-single"), tmp_path / "one.png")
    assert count(tmp_path / "one.png", REACHED_COLOR) > 0


def test_targets_picture_of_nothing(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="no results"):
        targets_picture({}, load_robot("paper"), tmp_path / "none.png")
