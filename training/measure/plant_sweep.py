"""Measure success against the size of model errors, in every engine on the same targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tasks.catalogue import TASKS, make_task
from cdcsr.tasks.task import Task
from controllers.controller import Controller
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result, evaluate
from training.measure.plant_axes import Axis


class Row(NamedTuple):
    """One line of a table: an episode."""

    backend: str
    space: str
    axis: str
    level: float
    episode: int
    success: int
    length: int
    distance: float


@dataclass(frozen=True)
class Point:
    """The result of one controller on one plant in one engine."""

    backend: str
    space: str
    axis: Axis
    level: float
    result: Result | None
    """None if the engine could not simulate the plant, as a copy diverged."""
    diverged: str = ""
    """How many episodes diverged, as a text."""
    task: Task = TASKS["reach"]

    @property
    def rows(self) -> list[Row]:
        """The episodes as lines of a table."""
        if self.result is None:
            return []
        outcome = zip(self.result.success, self.result.length, self.result.distance, strict=True)
        return [
            Row(
                self.backend,
                self.space,
                self.axis.name,
                self.level,
                i,
                int(success),
                int(length),
                float(distance),
            )
            for i, (success, length, distance) in enumerate(outcome)
        ]

    def as_dict(self) -> dict[str, object]:
        """Return plain data."""
        data = {
            "backend": self.backend,
            "space": self.space,
            "axis": self.axis.name,
            "level": self.level,
        }
        if self.result is None:
            return {**data, "diverged": self.diverged}
        return {**data, **self.result.summary()}


def sweep(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    axis: Axis,
    levels: Sequence[float] | None = None,
    episodes: int = 100,
    seed: int = TEST_SEED,
    nominal: Point | None = None,
    progress: Callable[[Point], None] | None = None,
    task: str = "reach",
    start: str = "still",
) -> list[Point]:
    """Measure a controller on plants that differ ever more along one axis, up and then down.

    Each direction ends with the first level at which success is at most half of the nominal one, or
    which the engine cannot simulate.

    Args:
        controller: the controller that acts.
        robot: the model: the robot that the controller is for.
        backend: the engine.
        space: the operation space.
        axis: the kind of model error.
        levels: in any order; by default the axis's own. Nominal is always measured.
        episodes: how many episodes at each level.
        seed: seeds the targets, which are the same at all levels.
        nominal: the nominal point if it is measured already, as it is the same on all axes.
        progress: called with each finished point.
        task: the name of the task.
        start: the states in which episodes begin.

    Returns:
        The points: nominal, outwards up, outwards down.

    Raises:
        CdcsrError: nothing succeeds on the nominal plant, or a level is none of this axis.
    """

    def measured(level: float) -> Point:
        return _measure(controller, robot, backend, space, axis, level, episodes, seed, task, start)

    judged = make_task(task, robot)
    if nominal is None:
        nominal = measured(axis.nominal)
    else:
        nominal = Point(backend, space, axis, axis.nominal, nominal.result, task=judged)
    if nominal.result is None or nominal.result.rate == 0:
        raise CdcsrError(
            f"{controller.name!r} has no success in {backend} ({task}, {space}), so its success "
            "cannot halve; choose another controller, task or space."
        )
    points = [nominal]
    report = progress or (lambda _: None)
    report(nominal)
    for direction in directions(axis, levels):
        for level in direction:
            points.append(measured(level))
            report(points[-1])
            result = points[-1].result
            if result is None or result.rate <= nominal.result.rate / 2:
                break
    return points


def directions(axis: Axis, levels: Sequence[float] | None = None) -> list[list[float]]:
    """Return the levels above and below nominal, each outwards."""
    chosen = axis.levels if levels is None else levels
    above, below = (
        {x for x in chosen if x > axis.nominal},
        {x for x in chosen if x < axis.nominal},
    )
    return [sorted(above), sorted(below, reverse=True)]


def _measure(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    axis: Axis,
    level: float,
    episodes: int,
    seed: int,
    task: str,
    start: str,
) -> Point:
    plant = axis.plant(robot, level)
    result = evaluate(
        controller,
        robot,
        backend,
        space,
        episodes,
        seed,
        plant=plant,
        task=task,
        start=start,
    )
    judged = make_task(task, robot)
    if result.diverged:
        what = f"{result.diverged} of {episodes} episodes diverged in {backend}"
        return Point(backend, space, axis, level, None, what, judged)
    return Point(backend, space, axis, level, result, task=judged)


@dataclass(frozen=True)
class Halving:
    """The level, in one direction of an axis, at which success falls to half of the nominal."""

    backend: str
    axis: Axis
    up: bool
    level: float | None
    """Interpolated between two measured levels; None if success halved at no measured level."""
    last: Point
    """The outermost measured point."""

    @property
    def text(self) -> str:
        """The text for a table."""
        if self.last.result is None:
            return f"diverges at {self.last.level:g}"
        if self.level is None:
            return f"beyond {self.last.level:g} ({self.last.result.rate:.2f})"
        return f"{self.level:.3g}"

    def as_dict(self) -> dict[str, object]:
        """Return plain data."""
        return {
            "backend": self.backend,
            "axis": self.axis.name,
            "direction": "up" if self.up else "down",
            "level": self.level,
            "last_level": self.last.level,
            "last_rate": None if self.last.result is None else self.last.result.rate,
        }


def halvings(points: Sequence[Point]) -> list[Halving]:
    """Return the halving of each direction in the sweep of one axis in one engine."""
    nominal = points[0]
    assert nominal.result is not None
    half, found = nominal.result.rate / 2, []
    for up in (True, False):
        line = [
            nominal,
            *(p for p in points if p.level != nominal.level and (p.level > nominal.level) == up),
        ]
        level = None
        for before, after in pairwise(line):
            if before.result is not None and after.result is not None and after.result.rate <= half:
                share = (before.result.rate - half) / (before.result.rate - after.result.rate)
                level = nominal.axis.between(before.level, after.level, share)
                break
        if len(line) > 1:
            found.append(Halving(nominal.backend, nominal.axis, up, level, line[-1]))
    return found
