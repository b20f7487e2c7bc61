"""Episodes that were run in both engines, and those of them that end differently."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cdcsr.simulation.engines import backend_names, engine_title
from training.measure.plant_axes import AXES
from training.measure.statistics import disagreement
from training.study.declare.grid import AROUND
from training.study.report.cells import Table, Value
from training.study.report.records import Episodes, Run

DESCRIBED = "as described"
"""Stands where an axis of the plant would."""


def differences(runs: Sequence[Run]) -> Table:
    """Episodes in both engines on the same plant, by what is wrong with it, and how many end well in one only."""
    found: dict[str, list[tuple[Run, Episodes, Episodes]]] = {}
    for run in runs:
        for axis, pair in _pairs(run):
            found.setdefault(axis, []).append((run, *pair))
    rows: list[list[Value]] = []
    for axis in (
        DESCRIBED,
        *(name for name, axis in AXES.items() if not axis.idle & {*backend_names()}),
    ):
        pairs = found.get(axis, [])
        counts = sum(
            (np.array(disagreement(one.success, two.success)) for _, one, two in pairs),
            np.zeros(2, int),
        )
        which = filter(None, [_which(*pair) for pair in pairs if axis == DESCRIBED])
        rows.append(
            [
                axis if axis == DESCRIBED else AXES[axis].title,
                len({run.name for run, *_ in pairs}),
                sum(len(one) for _, one, _ in pairs),
                int(counts.sum()),
                *map(int, counts),
                "; ".join(which) or "-",
            ]
        )
    only = [f"only {engine_title(engine)}" for engine in backend_names()]
    note = (
        "Episodes of one policy on one target and plant, run in both engines, whatever the method, space, task or"
        " engine of training; those on changed plants at all levels that both could simulate, without the level"
        " trained on; what means nothing to one of them (the softness of cables) is left out. Last, on the described"
        " plant, which they are: run, space, target."
    )
    head = ("plant", "runs", "episodes in both", "end differently", *only, "which")
    return Table("engines", "Where the engines differ", note, head, rows)


def _pairs(run: Run) -> Iterator[tuple[str, tuple[Episodes, Episodes]]]:
    """The same episodes in both engines, with the axis of the plant along which they are."""
    for name in sorted({"nominal", AROUND, "plants"} & run.evaluations.keys()):
        rows = run.evaluations[name]
        cells = sorted(
            set(zip(rows.space.tolist(), rows.axis.tolist(), rows.level.tolist(), strict=True))
        )
        for space, axis, level in cells:
            changed = name == "plants"
            if changed and (axis not in AXES or level == AXES[axis].nominal):
                continue
            first, second = (
                rows.where(backend=engine, space=space, axis=axis, level=level)
                for engine in backend_names()
            )
            if len(first) and np.array_equal(first.episode, second.episode):
                yield axis if changed else DESCRIBED, (first, second)


def _which(run: Run, first: Episodes, second: Episodes) -> str:
    """The targets on which they differ, if there are any."""
    targets = first.episode[first.success != second.success]
    return f"`{run.name}`, {first.space[0]}, {', '.join(map(str, targets))}" if len(targets) else ""
