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
from cdcsr.tasks.workspace_map import load_workspace
from controllers.demonstrations import load
from training.commands.plot import _KINDS
from training.plots import measured, targets

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

    for module in (measured, targets):
        monkeypatch.setattr(module, "drawn", drawn)
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


def test_a_map_is_drawn_with_what_was_reached_in_it(tmp_path: Path, figures: list[Figure]) -> None:
    """Two views; of the three targets two are reached, and every outer face is in the body."""
    paper = load_robot("paper")
    whole = load_workspace(paper)
    places = whole.centers[:3].tolist()
    cell = CELL | {"space": "workspace", "success": [1, 0, 1], "length": [9] * 3, "targets": places}
    file = written(tmp_path / "cells.json", {"cells": [cell]})
    assert main(["plot", "workspace", file, "--out", str(tmp_path / "a.pdf")]) == 0
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    for axes in figures[0].axes:
        body, reached, missed = axes.collections
        assert [np.shape(part.get_offsets())[0] for part in (reached, missed)] == [2, 1]
        assert len(body.get_paths()) in (0, len(whole.hull))  # before and after it is projected
        assert not np.array_equal(reached.get_facecolor(), missed.get_facecolor())
    whole.save(tmp_path / "map.npz")
    argv = ["plot", "workspace", str(tmp_path / "map.npz"), "--out", str(tmp_path / "b.png")]
    assert main(argv) == 0
    assert [len(axes.collections) for axes in figures[1].axes] == [1, 1]
    assert main([*argv[:3], "--out", str(tmp_path / "c.png"), "--robot", "lab-arm"]) == 2


def test_parity_shows_differences_by_size_and_by_time_step(
    tmp_path: Path, figures: list[Figure]
) -> None:
    row = {"unit": "m/s", "median": 0.02, "p95": 0.3, "max": 0.5, "size_p95": 2.0}
    step = {"pair": "other - mujoco", "commands": "random", "differences": {"tip velocity": row}}
    loop = {
        "commands": "random",
        "time_steps": [2e-3, 1e-3],
        "errors": {"mujoco": [4e-3, 2e-3], "other": [6e-3, 3e-3]},
        "tip_distance": {"other": {"mean": [8e-3, 7e-3]}},
        "noise_floor": {"disturbance": 1e-6, "mean": 5e-8},
    }
    data = {"robot": "paper", "engines": ["mujoco", "other"], "one_step": [step]}
    file = written(tmp_path / "parity.json", data | {"open_loop": [loop]})
    assert main(["plot", "parity", file, "--out", str(tmp_path / "a.png")]) == 0
    one, several = figures[0].axes
    np.testing.assert_allclose(points(one.lines[0]), [(0.01, 0)])
    (path,) = one.collections[0].get_paths()
    np.testing.assert_allclose(np.asarray(path.vertices)[:, 0], [0.01, 0.15])
    shown = [points(line) for line in several.lines[:3]]
    np.testing.assert_allclose(shown[0], [(2, 4), (1, 2)])
    np.testing.assert_allclose(shown[1], [(2, 6), (1, 3)])
    np.testing.assert_allclose(shown[2], [(2, 8), (1, 7)])


def test_targets_are_drawn(tmp_path: Path) -> None:
    file = written(tmp_path / "cells.json", {"cells": [CELL | EPISODES]})
    assert main(["plot", "targets", file, "--out", str(tmp_path / "a.png")]) == 0
    assert (tmp_path / "a.png").stat().st_size > 5_000


@pytest.mark.parametrize("kind", [*_KINDS])
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
