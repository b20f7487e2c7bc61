"""Success against how wrong the second plant is, in every engine on the same plants and targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np

from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot
from cdcsr.tables import markdown
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.task import Task
from controllers.controller import Controller
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result, evaluate
from training.measure.plant_axes import Axis
from training.policy import Policy


class Row(NamedTuple):
    """One episode, as a line of a table."""

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
    """One policy on one plant in one engine."""

    backend: str
    space: str
    axis: Axis
    level: float
    result: Result | None
    """None where the engine could not simulate the plant: a copy diverged."""
    diverged: str = ""
    """What it said then."""
    task: str = "reach"

    @property
    def rows(self) -> list[Row]:
        """Its episodes."""
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

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
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
    policy: Controller,
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
) -> list[Point]:
    """Measure a policy on plants that differ ever more along one axis, up and then down.

    Each direction ends with the first level at which at most half of what succeeds on the nominal plant still does,
    or which the engine cannot simulate.

    Args:
        policy: who acts.
        robot: the robot it is for.
        backend: the engine.
        space: the operation space.
        axis: along which.
        levels: in any order; by default the axis's own. The nominal one is always measured.
        episodes: at each level.
        seed: of the targets, the same at all levels.
        nominal: if it is measured already, as it is the same on all axes.
        progress: called with each point as it is done.
        task: what it is to do.

    Returns:
        The points: nominal, outwards up, outwards down.

    Raises:
        CdcsrError: nothing succeeds on the nominal plant, or a level is none of this axis.
    """
    if nominal is None:
        nominal = _measure(policy, robot, backend, space, axis, axis.nominal, episodes, seed, task)
    else:
        nominal = Point(backend, space, axis, axis.nominal, nominal.result, task=task)
    if nominal.result is None or nominal.result.rate == 0:
        raise CdcsrError(
            f"{policy.name!r} has no success in {backend} ({task}, {space}); there is nothing to lose."
        )
    points = [nominal]
    if progress:
        progress(nominal)
    for direction in directions(axis, levels):
        for level in direction:
            points.append(
                _measure(policy, robot, backend, space, axis, level, episodes, seed, task)
            )
            if progress:
                progress(points[-1])
            result = points[-1].result
            if result is None or result.rate <= nominal.result.rate / 2:
                break
    return points


def directions(axis: Axis, levels: Sequence[float] | None = None) -> list[list[float]]:
    """Levels in two lists, each outwards from nominal: above it, below it."""
    chosen = axis.levels if levels is None else levels
    above, below = (
        {x for x in chosen if x > axis.nominal},
        {x for x in chosen if x < axis.nominal},
    )
    return [sorted(above), sorted(below, reverse=True)]


def _measure(
    policy: Controller,
    robot: Robot,
    backend: str,
    space: str,
    axis: Axis,
    level: float,
    episodes: int,
    seed: int,
    task: str,
) -> Point:
    learned = policy if isinstance(policy, Policy) else None
    try:
        result = evaluate(
            policy,
            robot,
            backend,
            space,
            episodes,
            seed,
            centers=None if learned is None else learned.centers,
            frame_skip=1 if learned is None else learned.frame_skip,
            plant=axis.plant(robot, level),
            task=task,
        )
    except Diverged as error:
        return Point(backend, space, axis, level, None, str(error).partition(";")[0], task)
    return Point(backend, space, axis, level, result, task=task)


@dataclass(frozen=True)
class Halving:
    """Where, along one direction of an axis in one engine, success falls to half of the nominal."""

    backend: str
    axis: Axis
    up: bool
    level: float | None
    """Interpolated between two measured levels; None if success did not halve at any that was measured."""
    last: Point
    """The outermost that was measured."""

    @property
    def text(self) -> str:
        """For a table."""
        if self.last.result is None:
            return f"diverges at {self.last.level:g}"
        if self.level is None or self.axis.unit == "switch":
            return f"{'beyond ' * (self.level is None)}{self.last.level:g} ({self.last.result.rate:.2f})"
        return f"{self.level:.3g}"

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "backend": self.backend,
            "axis": self.axis.name,
            "direction": "up" if self.up else "down",
            "level": self.level,
            "last_level": self.last.level,
            "last_rate": None if self.last.result is None else self.last.result.rate,
        }


def halvings(points: Sequence[Point]) -> list[Halving]:
    """One for each direction of the sweep of one axis in one engine."""
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


@dataclass(frozen=True)
class Difference:
    """One episode that ends differently on two plants: in another engine, or at another level."""

    episode: int
    better: Point
    """Where it succeeds."""
    worse: Point

    def as_dict(self) -> dict[str, Any]:
        """Plain data: which one, and what is known of why."""
        good, bad, i = self.better.result, self.worse.result, self.episode
        assert good is not None
        assert bad is not None
        distance, length = float(bad.distance[i]), int(good.length[i])
        return {
            "axis": self.worse.axis.name,
            "episode": i,
            "target": good.targets[i].tolist(),
            "succeeds": {
                "backend": self.better.backend,
                "level": self.better.level,
                "length": length,
            },
            "fails": {
                "backend": self.worse.backend,
                "level": self.worse.level,
                "distance": distance,
            },
            "reading": _reading(make_task(self.worse.task), distance, length),
        }


def _reading(task: Task, distance: float, length: int) -> str:
    """Why an episode may have ended differently, from where one ended and how long the other took."""
    threshold = task.threshold
    if distance <= threshold:
        return f"at the target, and not as {task.name} asks: ends {distance * 1e3:.0f} mm from it"
    if distance <= 2 * threshold:
        return f"near miss: ends {distance * 1e3:.0f} mm from the target, {threshold * 1e3:.0f} are allowed"
    if length > 0.9 * task.max_steps:
        return f"late: succeeds after {length} of {task.max_steps} steps"
    return f"another path: ends {distance * 1e3:.0f} mm from the target"


def differences(first: Point, second: Point) -> list[Difference]:
    """The episodes that succeed at one point only."""
    if first.result is None or second.result is None:
        return []
    a, b = first.result.success, second.result.success
    found = [Difference(int(i), first, second) for i in np.flatnonzero(a & ~b)]
    found += [Difference(int(i), second, first) for i in np.flatnonzero(b & ~a)]
    return sorted(found, key=lambda difference: difference.episode)


def between_engines(points: Sequence[Point]) -> list[Difference]:
    """The episodes that end differently in two engines on the same plant."""
    groups: dict[tuple[str, float], list[Point]] = {}
    for point in points:
        groups.setdefault((point.axis.name, point.level), []).append(point)
    return [
        d for group in groups.values() for a, b in combinations(group, 2) for d in differences(a, b)
    ]


def between_plants(points: Sequence[Point]) -> list[Difference]:
    """The episodes that end differently in the same engine on the nominal and on a changed plant."""
    nominal = {(p.axis.name, p.backend): p for p in points if p.level == p.axis.nominal}
    return [d for p in points for d in differences(nominal[p.axis.name, p.backend], p)]


def format_sweep(points: Sequence[Point]) -> str:
    """A Markdown table, one row for each axis and direction.

    The gaps are at the outermost level that every engine has measured: from the parameters, what each engine loses
    against its own nominal plant; from the engine, how far two are apart on that same plant, and how many episodes
    succeed in one only.
    """
    backends = list(dict.fromkeys(point.backend for point in points))
    by = {(p.backend, p.axis.name, p.level): p.result for p in points if p.result is not None}
    pairs = list(combinations(backends, 2))
    head = [
        "axis",
        "unit",
        "to",
        *(f"{b}: halves at" for b in backends),
        "compared at",
        "gap from parameters",
    ]
    head += [f"gap from engine: {a} - {b} (only / only)" for a, b in pairs]
    rows = []
    for axis in dict.fromkeys(point.axis for point in points):
        lines = [
            halvings([p for p in points if p.axis is axis and p.backend == b]) for b in backends
        ]
        for each in zip(*lines, strict=True):
            shared = [
                level
                for level in directions(axis, [p.level for p in points if p.axis is axis])[
                    0 if each[0].up else 1
                ]
                if all((b, axis.name, level) in by for b in backends)
            ]
            row = [
                axis.name,
                axis.unit,
                "up" if each[0].up else "down",
                *(halving.text for halving in each),
            ]
            if not shared:
                rows.append([*row, *["-"] * (2 + len(pairs))])
                continue
            there = {b: by[b, axis.name, shared[-1]] for b in backends}
            losses = [by[b, axis.name, axis.nominal].rate - there[b].rate for b in backends]
            row += [f"{shared[-1]:g}", " / ".join(f"{loss:+.2f}" for loss in losses)]
            for a, b in pairs:
                x, y = there[a].success, there[b].success
                row.append(
                    f"{x.mean() - y.mean():+.2f} ({int((x & ~y).sum())} / {int((y & ~x).sum())})"
                )
            rows.append(row)
    return markdown(head, rows)
