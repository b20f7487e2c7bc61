"""A sweep over model errors: where it stops, and what its table and files say."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tasks.catalogue import TASKS
from tests.support.controllers import Still
from training.commands.sweep import sweep as command
from training.config.run_description import SCRIPTED, RunDescription
from training.measure import plant_sweep as sweeps
from training.measure.evaluation import Result
from training.measure.plant_axes import AXES, ActualPlant
from training.measure.plant_sweep import Point, directions, halvings, sweep
from training.measure.sweep_table import between_engines, differences, format_sweep
from training.study.execute import evaluations


def _result(success: list[bool], distance: float = 0.5, length: int = 100) -> Result:
    done = np.array(success)
    n = len(done)
    return Result(
        done,
        np.where(done, length, 250),
        np.where(done, 0.02, distance),
        np.arange(3.0 * n).reshape(n, 3),
    )


def _scripted(monkeypatch: pytest.MonkeyPatch, rates: dict[float, float | None]) -> list[float]:
    """Make the first episodes of ten succeed, as many as `rates` say; where it says None, diverge.

    Returns:
        The levels that are measured, in order.
    """
    asked: list[float] = []

    def measured(*_: object, plant: ActualPlant, **__: object) -> Result:
        mass = 1.0 if plant.parameters is None else plant.parameters.link_mass
        level = float(np.asarray(mass))
        asked.append(level)
        rate = rates[level]
        if rate is None:
            return replace(_result([True] * 10), diverged=3)
        return _result([i < 10 * rate for i in range(10)])

    monkeypatch.setattr(sweeps, "evaluate", measured)
    return asked


def test_a_sweep_goes_outwards_until_success_halves(
    monkeypatch: pytest.MonkeyPatch, paper: Robot
) -> None:
    asked = _scripted(monkeypatch, {1: 1.0, 2: 0.8, 4: 0.4, 0.5: 0.9, 0.25: None})
    points = sweep(
        Still(), paper, "mujoco", "anchor", AXES["link_mass"], [8, 0.25, 2, 0.125, 4, 0.5], 10
    )
    assert asked == [1, 2, 4, 0.5, 0.25]
    up, down = halvings(points)
    # A half lies three quarters of the way from 0.8 to 0.4; in ratio, 2 * 2 ** 0.75.
    assert up.level == pytest.approx(2 * 2**0.75)
    assert (down.level, down.text) == (None, "diverges at 0.25")
    assert [row.level for row in points[1].rows] == [2.0] * 10
    assert points[-1].rows == []
    assert points[-1].diverged == "3 of 10 episodes diverged in mujoco"
    assert points[-1].as_dict()["diverged"] == points[-1].diverged


def test_offsets_are_interpolated_by_difference() -> None:
    assert AXES["command_delay"].between(2, 4, 0.5) == 3
    assert AXES["link_mass"].between(1, 4, 0.5) == pytest.approx(sqrt(4))
    assert directions(AXES["rest_length_offset"], [0.1, -0.2, 0, -0.1]) == [[0.1], [-0.1, -0.2]]


def test_nothing_to_lose_is_an_error(monkeypatch: pytest.MonkeyPatch, paper: Robot) -> None:
    _scripted(monkeypatch, {1: 0.0})
    with pytest.raises(CdcsrError, match=r"'still' has no success in mujoco \(precise, anchor\)"):
        sweep(Still(), paper, "mujoco", "anchor", AXES["link_mass"], task="precise")


def test_every_point_is_of_the_task(monkeypatch: pytest.MonkeyPatch, paper: Robot) -> None:
    tasks: list[str] = []

    def measured(*_: object, task: str = "reach", **__: object) -> Result:
        tasks.append(task)
        return _result([True])

    for module in (sweeps, evaluations):
        monkeypatch.setattr(module, "evaluate", measured)
    subject = evaluations.Subject(
        RunDescription(algorithm=SCRIPTED, task="capture", updates=0), Still(), paper
    )
    assert len(list(evaluations.plants(subject, 1))) > 2 * len(AXES)
    assert set(tasks) == {"capture"}


def test_differences_name_the_episode_and_a_reading() -> None:
    axis = AXES["link_mass"]
    first = Point("mujoco", "anchor", axis, 2.0, _result([True, True, False], 0.05))
    second = Point("pybullet", "anchor", axis, 2.0, _result([False, True, True], 0.2, 240))
    found = differences(first, second)
    assert [(d.episode, d.better.backend) for d in found] == [(0, "mujoco"), (2, "pybullet")]
    assert found[0].reading == "another path: ends 200 mm from the target"
    assert found[1].reading.startswith("near miss: ends 50 mm")
    assert found[0].target == [0, 1, 2]
    assert len(between_engines([first, second])) == 2
    captured, missed = (
        Point("mujoco", "anchor", axis, 2.0, _result([True], length=240), task=TASKS["capture"]),
        [],
    )
    for distance in (0.02, 0.2):
        other = Point(
            "pybullet", "anchor", axis, 2.0, _result([False], distance), task=TASKS["capture"]
        )
        missed.append(differences(captured, other)[0].reading)
    # Near is not enough to capture, and 240 of 500 steps are not late.
    assert missed[0] == "at the target, but not as capture asks: ends 20 mm from it"
    assert missed[1] == "another path: ends 200 mm from the target"


def test_the_table_tells_the_engines_gap_from_the_parameters() -> None:
    axis = AXES["command_delay"]
    points = [
        Point(backend, "anchor", axis, level, _result([i < successes for i in range(10)]))
        for backend, counts in (("mujoco", (10, 8, 4)), ("pybullet", (10, 6, 3)))
        for level, successes in zip((0.0, 1.0, 2.0), counts, strict=True)
    ]
    row = " ".join(format_sweep(points).splitlines()[2].split())
    assert row == "| command_delay | steps | up | 1.75 | 1.33 | 2 | +0.60 / +0.70 | +0.10 (1 / 0) |"


def test_the_command_writes_every_episode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, data = tmp_path / "plants.csv", tmp_path / "plants.json"
    command(
        "jacobian",
        backend="mujoco",
        axis=("time_step",),
        episodes=2,
        seed=1,
        csv=table,
        json=data,
    )
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert ",".join(rows[0]) == "backend,space,axis,level,episode,success,length,distance,crc32"
    found = [(row["level"], row["episode"]) for row in rows]
    levels = [1.0, 0.5, 0.25, 0.125]
    assert found == [(str(level), episode) for level in levels for episode in "01"]
    assert [point["level"] for point in json.loads(data.read_text("utf-8"))["points"]] == levels
    assert "| time_step | factor | down |" in capsys.readouterr().out
