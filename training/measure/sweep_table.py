"""Show a sweep over model errors: its table, and the episodes that end differently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cdcsr.robot.ruler import millimetres
from cdcsr.tables import markdown
from cdcsr.tasks.task import Task
from training.measure.plant_sweep import Point, directions, halvings
from training.measure.statistics import disagreement


@dataclass(frozen=True)
class Difference:
    """An episode that ends differently on two plants: in another engine, or at another level."""

    episode: int
    better: Point
    """The point at which it succeeds."""
    worse: Point
    """The point at which it fails."""

    target: list[float]
    """Where the target was at the start, in [m]."""
    length: int
    """The number of steps until the success."""
    distance: float
    """From tip to target at the end of the failure, in [m]."""

    @property
    def reading(self) -> str:
        """A guess why the episode failed, from this distance and length."""
        return _reading(self.worse.task, self.distance, self.length)

    def as_dict(self) -> dict[str, object]:
        """Return plain data: which episode, and why it may have ended differently."""
        better, worse = self.better, self.worse
        return {
            "axis": worse.axis.name,
            "episode": self.episode,
            "target": self.target,
            "succeeds": {"backend": better.backend, "level": better.level, "length": self.length},
            "fails": {"backend": worse.backend, "level": worse.level, "distance": self.distance},
            "reading": self.reading,
        }


def _reading(task: Task, distance: float, length: int) -> str:
    """Say why an episode may have failed, from its last distance and the success's length."""
    threshold, ends = task.threshold, f"ends {millimetres(distance, task.threshold)} mm from"
    if distance <= threshold:
        return f"at the target, but not as {task.name} asks: {ends} it"
    if distance <= 2 * threshold:
        return f"near miss: {ends} the target, {millimetres(threshold, threshold)} are allowed"
    if length > 0.9 * task.max_steps:
        return f"late: succeeds after {length} of {task.max_steps} steps"
    return f"another path: {ends} the target"


def differences(first: Point, second: Point) -> list[Difference]:
    """Return the episodes that succeed at one of two points only."""
    if first.result is None or second.result is None:
        return []
    found = []
    for i in np.flatnonzero(first.result.success != second.result.success):
        points = (first, second) if first.result.success[i] else (second, first)
        good, bad = (point.result for point in points)
        assert good is not None
        assert bad is not None
        target, length = good.targets[i].tolist(), int(good.length[i])
        found.append(Difference(int(i), *points, target, length, float(bad.distance[i])))
    return found


def between_engines(points: Sequence[Point]) -> list[Difference]:
    """Return the episodes that end differently in two engines on the same plant."""
    groups: dict[tuple[str, float], list[Point]] = {}
    for point in points:
        groups.setdefault((point.axis.name, point.level), []).append(point)
    return [
        d for group in groups.values() for a, b in combinations(group, 2) for d in differences(a, b)
    ]


def between_plants(points: Sequence[Point]) -> list[Difference]:
    """Return the episodes that end differently in one engine on the nominal and a changed plant."""
    nominal = {(p.axis.name, p.backend): p for p in points if p.level == p.axis.nominal}
    return [d for p in points for d in differences(nominal[p.axis.name, p.backend], p)]


def as_dict(lines: Sequence[Sequence[Point]]) -> dict[str, object]:
    """Return a sweep as plain data; each line holds the points of one axis in one engine."""
    points = [point for line in lines for point in line]
    return {
        "points": [point.as_dict() for point in points],
        "halvings": [halving.as_dict() for line in lines for halving in halvings(line)],
        "between_engines": [difference.as_dict() for difference in between_engines(points)],
        "between_plants": [difference.as_dict() for difference in between_plants(points)],
    }


def format_sweep(points: Sequence[Point]) -> str:
    """Return a sweep as a Markdown table, with a row for each axis and direction.

    The gaps are at the outermost level that every engine has measured. The gap from parameters is
    what an engine loses against its own nominal plant. The gap from the engine is how far two
    engines are apart on that plant, with the numbers of episodes that succeed in one only.
    """
    backends = list(dict.fromkeys(point.backend for point in points))
    pairs = list(combinations(backends, 2))
    halves = [f"{backend}: halves at" for backend in backends]
    head = ["axis", "unit", "to", *halves, "compared at", "gap from parameters"]
    head += [f"gap from engine: {a} - {b} (only / only)" for a, b in pairs]
    rows = []
    for axis in dict.fromkeys(point.axis for point in points):
        on_axis = [point for point in points if point.axis is axis]
        lines = [halvings([p for p in on_axis if p.backend == b]) for b in backends]
        for each in zip(*lines, strict=True):
            up = each[0].up
            texts = (halving.text for halving in each)
            gaps = _gaps(on_axis, backends, up) or ["-"] * (2 + len(pairs))
            rows.append([axis.name, axis.unit, "up" if up else "down", *texts, *gaps])
    return markdown(head, rows)


def _gaps(points: Sequence[Point], backends: Sequence[str], up: bool) -> list[str]:
    """Return the cells of one row from "compared at" on; none if the engines share no level."""
    axis = points[0].axis
    by = {(p.backend, p.level): p.result for p in points if p.result is not None}
    levels = directions(axis, [point.level for point in points])[0 if up else 1]
    shared = [level for level in levels if all((b, level) in by for b in backends)]
    if not shared:
        return []
    there = {b: by[b, shared[-1]] for b in backends}
    losses = [by[b, axis.nominal].rate - there[b].rate for b in backends]
    cells = [f"{shared[-1]:g}", " / ".join(f"{loss:+.2f}" for loss in losses)]
    for a, b in combinations(backends, 2):
        x, y = there[a].success, there[b].success
        only, other = disagreement(x, y)
        cells.append(f"{x.mean() - y.mean():+.2f} ({only} / {other})")
    return cells
