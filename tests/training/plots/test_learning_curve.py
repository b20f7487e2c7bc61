"""The learning curve: every run is in it."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.plots import COLORS
from tests.support.pixels import count_pixels
from training.measure.evaluation import wilson
from training.plots.learning_curve import draw_learning_curve
from training.run.metrics import Metrics


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
    draw_learning_curve([run], tmp_path / "one.png")
    draw_learning_curve([run, run.parent / "empty"], tmp_path / "same.png", {"BC": 0.7})
    assert count_pixels(tmp_path / "one.png", COLORS[0]) > 500
    assert (tmp_path / "one.png").read_bytes() != (tmp_path / "same.png").read_bytes()
    height, width, _ = imageio.imread(tmp_path / "one.png").shape
    assert 400 < height < width < 1400


def test_learning_curve_is_the_same_each_time(run: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_learning_curve([run], tmp_path / name, {"BC": 0.7, "demonstrator": 0.93})
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_learning_curve_without_metrics(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"No run has metrics to draw yet: .*nothing"):
        draw_learning_curve([tmp_path / "nothing"], tmp_path / "curve.png")
    assert not (tmp_path / "curve.png").exists()
