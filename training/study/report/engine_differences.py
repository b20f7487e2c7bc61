"""Compare engines: the same episodes in each of them, and each with its stock settings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from cdcsr.simulation.engines import backend_names, engine_title
from training.measure.plant_axes import AXES
from training.measure.statistics import disagreement
from training.study.declare.grid import AROUND
from training.study.report.cells import COST, TRAINED, Table, Value, cost, measure, trained
from training.study.report.records import (
    DEMONSTRATIONS,
    SPACES,
    Episodes,
    Run,
    at_home,
    grouped,
    is_of_paper,
)
from training.study.report.table_parts import basis, engines_of, success

DESCRIBED = "as described"
"""The name of the unchanged plant, in the place of an axis."""


def transfer(runs: Sequence[Run]) -> Table:
    """Return every method trained in each engine and tested in each, on the same targets."""
    chosen = [run for run in runs if is_of_paper(run.setting) and not run.setting.changes]
    chosen = [run for run in chosen if run.setting.num_demonstrations in (0, DEMONSTRATIONS)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for space in SPACES:
        for setting, group in grouped(chosen, "space").items():
            seeds = at_home(group, space)
            if seeds:
                values = _in_engines(seeds, engines, space)
                rows.append([SPACES[space], *trained(setting), *values, *cost(seeds)])
    head = ("space", *TRAINED, *_heads(engines), *COST)
    note = basis(chosen) + (
        " Disagreements count the episodes of all seeds that succeed in one engine only."
    )
    return Table("transfer", "Transfer between engines", note, head, rows)


def tasks(runs: Sequence[Run]) -> Table:
    """Return tasks and spaces beyond the paper, in every engine."""
    chosen = [run for run in runs if not is_of_paper(run.setting)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for setting, group in sorted(
        grouped(chosen).items(), key=lambda item: (item[0].task, item[0].space)
    ):
        values = _in_engines(group, engines, setting.space)
        rows.append([setting.task, setting.space, *trained(setting), *values, *cost(group)])
    head = ("task", "space", *TRAINED, *_heads(engines), *COST)
    return Table("tasks", "Tasks beyond the paper", basis(chosen), head, rows)


def differences(runs: Sequence[Run]) -> Table:
    """Count the episodes that succeed in one engine only on the same plant, by its axis."""
    found: dict[str, list[tuple[Run, Episodes, Episodes]]] = {}
    for run in runs:
        for axis, pair in _pairs(run):
            found.setdefault(axis, []).append((run, *pair))
    rows: list[list[Value]] = []
    for axis in (DESCRIBED, *AXES):
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
        "Episodes of one policy on one target and plant, run in both engines, whatever the method,"
        " space, task or engine of training; on changed plants at all levels that both could"
        " simulate, without the level of training. The last column names the episodes on the"
        " described plant: run, space, target."
    )
    head = ("plant", "runs", "episodes in both", "end differently", *only, "which")
    return Table("engines", "Where the engines differ", note, head, rows)


def stock_settings(runs: Sequence[Run]) -> Table:
    """Compare success with the engines' stock settings and with those that agree, by policy.

    The rows are of an earlier version, in which this was an axis of the plant; see
    :data:`training.measure.plant_axes.RETIRED_AXES`. A run's episodes are on the same targets both
    times.
    """
    rows: list[list[Value]] = []
    chosen = [run for run in runs if "plants" in run.evaluations]
    for setting, group in grouped(chosen).items():
        for engine in engines_of(group, "plants"):
            stock = measure(group, "plants", engine, axis="engine_defaults", level=1.0)
            if stock is None:
                continue
            agreed = measure(stock.runs, "plants", engine, axis="engine_defaults", level=0.0)
            counts = [len(one) for one in stock.episodes]
            values = [agreed.success if agreed else None, stock.success, counts[0]]
            names = [*trained(setting), SPACES.get(setting.space, setting.space)]
            rows.append([*names, engine_title(engine), *values, len(stock.runs)])
    head = (*TRAINED, "space", "tested in", "κ agreed", "κ stock", "episodes", "seeds")
    note = basis(chosen) + (
        " Measured in an earlier version. Agreed: the settings with which MuJoCo and the PyBullet"
        " of that version agreed. Stock: MuJoCo's Euler integrator and softness of limits;"
        " PyBullet's damping of 0.04 and clamp on joint speeds."
    )
    return Table("stock", "With the engines' stock settings", note, head, rows)


def _heads(engines: Sequence[str]) -> list[str]:
    titles = [engine_title(name) for name in engines]
    return [f"κ in {title}" for title in titles] + [
        f"only {a} / only {b}" for a, b in combinations(titles, 2)
    ]


def _in_engines(seeds: Sequence[Run], engines: Sequence[str], space: str) -> list[Value]:
    values = [success(seeds, "nominal", space, engine) for engine in engines]
    return values + [_disagreements(seeds, pair, space) for pair in combinations(engines, 2)]


def _disagreements(seeds: Sequence[Run], engines: tuple[str, str], space: str) -> Value:
    counts, total = np.zeros(2, dtype=int), 0
    for run in seeds:
        if "nominal" in run.evaluations:
            first, second = (
                run.evaluations["nominal"].where(backend=name, space=space) for name in engines
            )
            if len(first) and np.array_equal(first.episode, second.episode):
                counts += disagreement(first.success, second.success)
                total += len(first)
    return f"{counts[0]} / {counts[1]} of {total}" if total else None


def _pairs(run: Run) -> Iterator[tuple[str, tuple[Episodes, Episodes]]]:
    """Yield the same episodes in both engines, with the axis of the plant."""
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
    """Name the targets that only one engine reaches; empty if there are none."""
    targets = first.episode[first.success != second.success]
    return f"`{run.name}`, {first.space[0]}, {', '.join(map(str, targets))}" if len(targets) else ""
