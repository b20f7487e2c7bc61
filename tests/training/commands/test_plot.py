"""Plots show the numbers in the files that other commands wrote."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cdcsr.cli import main
from cdcsr.robot.description import load_robot
from controllers.demonstrations import load
from training.plots import measured

CELL = {"controller": "jacobian", "backend": "mujoco", "space": "anchor", "success_rate": 0.7}
RANGE = {"success_low": 0.4, "success_high": 0.89}
EPISODES = {"success": [True, False], "length": [9, 20], "targets": [[0.1, 0, 2], [0.2, 0, 2]]}
POINT = {"backend": "mujoco", "space": "anchor", "axis": "link_mass", **RANGE}


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Return the figures that are drawn, when they are drawn."""
    found: list[Figure] = []
    original: Callable = measured.drawn

    @contextmanager
    def drawn(*given: object) -> Iterator[Figure]:
        with original(*given) as figure:
            found.append(figure)
            yield figure

    monkeypatch.setattr(measured, "drawn", drawn)
    return found


def points(line: Line2D) -> NDArray[np.float64]:
    """Return the points of a line, shape (n, 2)."""
    return np.array([line.get_xdata(), line.get_ydata()], dtype=float).T


def written(path: Path, data: object) -> str:
    path.write_text(json.dumps(data))
    return str(path)


def test_a_matrix_says_the_success_and_its_interval(tmp_path: Path, figures: list[Figure]) -> None:
    cells = [CELL | RANGE, CELL | RANGE | {"backend": "pybullet", "success_rate": 0.2}]
    file = written(tmp_path / "cells.json", {"cells": cells})
    assert main(["plot", "matrix", file, "--out", str(tmp_path / "a.png")]) == 0
    panel = figures[0].axes[0]
    assert [text.get_text() for text in panel.texts] == ["0.70\n0.40–0.89", "0.20\n0.40–0.89"]
    assert [label.get_text() for label in panel.get_xticklabels()] == ["MuJoCo", "PyBullet"]
    np.testing.assert_allclose(np.array(panel.images[0].get_array()), [[0.7, 0.2]])


def test_a_sweep_is_a_line_in_the_order_of_its_levels(
    tmp_path: Path, figures: list[Figure]
) -> None:
    rows = [POINT | {"level": x, "success_rate": x / 2} for x in (1.5, 0.5, 1.0)]
    rows.append(POINT | {"level": 2.0, "success_rate": 0.9, "axis": "servo_gain"})
    file = written(tmp_path / "sweep.json", {"points": rows})
    assert main(["plot", "sweep", file, "--out", str(tmp_path / "a.pdf")]) == 0
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    panel, other, *_ = figures[0].axes
    np.testing.assert_allclose(points(panel.lines[0]), [(0.5, 0.25), (1, 0.5), (1.5, 0.75)])
    assert panel.get_xlabel() == "link mass [factor]"
    assert other.get_xlabel() == "servo gain [factor]"


def test_an_episode_shows_what_was_recorded(tmp_path: Path, figures: list[Figure]) -> None:
    data, robot = tmp_path / "demos", load_robot("planar-single")
    argv = ["demonstrate", "--out", str(data), "--robot", robot.name, "--episodes", "2"]
    assert main(argv) == 0
    out = str(tmp_path / "a.png")
    argv = ["plot", "episode", str(data), "--out", out, "--episode", "2", "--backend", "mujoco"]
    assert main(argv) == 0
    episode = load(data, robot.fingerprint)[1]
    distance, travel, tension, shift, _ = figures[0].axes
    expected = 1e3 * episode.observations
    np.testing.assert_allclose(points(distance.lines[0])[:, 1], expected[:, 9], atol=1e-6)
    for n in range(robot.num_cables):
        np.testing.assert_allclose(points(travel.lines[n])[:, 1], expected[:, 23 + n], atol=1e-6)
    start = robot.base.position[2]
    np.testing.assert_allclose(
        points(shift.lines[2])[:, 1], expected[:, 12] - 1e3 * start, atol=1e-6
    )
    assert np.ptp(points(tension.lines[0])[:, 1]) > 0
    assert main(argv) == 2  # the picture is there


def test_targets_are_drawn(tmp_path: Path) -> None:
    file = written(tmp_path / "cells.json", {"cells": [CELL | EPISODES]})
    assert main(["plot", "targets", file, "--out", str(tmp_path / "a.png")]) == 0
    assert (tmp_path / "a.png").stat().st_size > 5_000


@pytest.mark.parametrize("kind", ["targets", "matrix", "sweep", "learning", "episode"])
def test_an_input_of_another_kind_is_one_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path / "other.json", {"cells": [{"a": 1}], "points": [{"b": 2}]})
    assert main(["plot", kind, file, "--out", str(tmp_path / "a.png")]) == 2
    said = capsys.readouterr().err
    assert f"cannot be drawn as {kind}" in said
    assert "sweep: the JSON file of `cdcsr sweep`" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "a.png").exists()
