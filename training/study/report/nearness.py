"""Success by the distance from target to nearest demonstration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.plots import drawn
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import engine_title
from cdcsr.tasks.spaces import demonstration_targets, make_space
from training.algorithms.registry import algorithm_color, algorithm_title
from training.config.run_description import RunDescription
from training.config.seeds import TEST_SEED
from training.measure.statistics import Estimate, rate
from training.study.declare.grid import ABLATIONS
from training.study.report.cells import COST, TRAINED, Table, amount, cost, measure, trained
from training.study.report.learning_curves import Figures, legend, tidy
from training.study.report.records import (
    DEMONSTRATIONS,
    JACOBIAN,
    REACH,
    SPACES,
    Run,
    at_home,
    grouped,
    is_extra,
    shared,
)
from training.study.report.table_parts import basis

ROBOT = "paper"
"""The robot of the study; runs of another one have other targets and are left out."""
TOLD = ("anchor", "spatter")
"""Spaces with targets far from all demonstrations; in Floating all are within 10 mm of one."""
BOUNDS = (0.0, 0.03, 0.06, 0.09, np.inf)
"""Bounds of the bins of distance, in [m]; the paper's threshold comes first."""
_BINS = [
    f"to {1e3 * high:g} mm" if np.isfinite(high) else f"from {1e3 * low:g} mm"
    for low, high in pairwise(BOUNDS)
]
_TICKS = [
    f"< {1e3 * high:g}" if np.isfinite(high) else f"≥ {1e3 * low:g}"
    for low, high in pairwise(BOUNDS)
]
_COLUMNS = 4


class Row(NamedTuple):
    """The success of some seeds in their space: number of targets and success in each bin."""

    task: str
    space: str
    setting: RunDescription
    seeds: list[Run]
    bins: list[tuple[int, Estimate | None]]


def near_and_far(runs: Sequence[Run]) -> list[Row]:
    """Return success on held-out targets by distance, in space and engine of training.

    Reaching comes first. Only runs with the ten demonstrations and unchanged algorithms count.
    """
    robot, rows = load_robot(ROBOT), []
    chosen = [run for run in runs if run.fingerprint == robot.fingerprint and _as_shown(run)]
    for task in sorted(
        {run.setting.task for run in chosen}, key=lambda task: (task != REACH, task)
    ):
        groups = grouped((run for run in chosen if run.setting.task == task), "space")
        for space in TOLD:
            for setting, group in groups.items():
                cell = measure(seeds := at_home(group, space), "nominal", space=space)
                if cell is None:
                    continue
                bins: list[tuple[int, Estimate | None]] = []
                far = [distances(robot, space, len(one)) for one in cell.episodes]
                for low, high in pairwise(BOUNDS):
                    inside = [(low <= metres) & (metres < high) for metres in far]
                    found = [
                        one.success[mask] for one, mask in zip(cell.episodes, inside, strict=True)
                    ]
                    bins.append((len(found[0]), rate(found) if len(found[0]) else None))
                rows.append(Row(task, space, setting, seeds, bins))
    return rows


def nearness(runs: Sequence[Run]) -> Table:
    """Build the table of success by distance to the nearest demonstration."""
    rows = near_and_far(runs)
    values = [
        [
            row.task,
            SPACES[row.space],
            *trained(row.setting),
            *("-" if x is None else x for pair in row.bins for x in pair),
            *cost(row.seeds),
        ]
        for row in rows
    ]
    head = (
        "task",
        "space",
        *TRAINED,
        *(x for name in _BINS for x in (f"targets {name}", f"κ {name}")),
        *COST,
    )
    note = (
        "Held-out targets by their distance to the nearest of the ten that were demonstrated, for"
        " preset `tuned`: "
        "in Anchor Space some are far from all of them, which success as a whole does not show. "
    )
    seen = {run.name: run for row in rows for run in row.seeds}
    return Table(
        "nearness",
        "Near a demonstration, and far from all",
        note + basis([*seen.values()]),
        head,
        values,
    )


def far_captures(runs: Sequence[Run]) -> Table:
    """Return CLASP's captures far from all demonstrations, seed by seed, also of seeds beyond the
    budget."""
    robot, rows = load_robot(ROBOT), []
    chosen = [
        run
        for run in shared(runs)
        if run.fingerprint == robot.fingerprint
        and _as_shown(run)
        and (run.setting.algorithm, run.setting.task, run.setting.space)
        == ("clasp", "capture", "anchor")
    ]
    groups: dict[tuple[str, bool], list[Run]] = {}
    for run in chosen:
        groups.setdefault((run.setting.backend, is_extra(run)), []).append(run)
    for (engine, _), group in sorted(groups.items()):
        found = [run.evaluations["nominal"].where(backend=engine) for run in group]
        far = [distances(robot, "anchor", len(one)) >= BOUNDS[-2] for one in found]
        rates = [one.success[mask] for one, mask in zip(found, far, strict=True)]
        seeds = sorted(run.seed or 0 for run in group)
        each = ", ".join(f"{one.mean():.2f}" for one in rates)
        rows.append([engine_title(engine), f"{seeds[0]} to {seeds[-1]}", rate(rates), each])
    note = "Targets at 90 mm or more from all ten demonstrations, in the engine of training. "
    head = ("trained in", "seeds", "κ", "of each seed")
    return Table("far-captures", "CLASP's captures far from all demonstrations", note, head, rows)


def nearness_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw success by distance for each engine of training: no ablations, and the usual length."""
    rows = [row for row in near_and_far(runs) if row.setting.algorithm not in ABLATIONS[1:]]
    for engine in sorted({row.setting.backend for row in rows}):
        own = [row for row in rows if row.setting.backend == engine]
        lengths = Counter(row.setting.updates for row in own if row.setting.updates)
        usual = (0, *(length for length, _ in lengths.most_common(1)))
        own = [row for row in own if row.setting.updates in usual]
        file = f"nearness-{engine}.png"
        _draw(own, out / file)
        yield (
            file,
            "Success by the distance from target to nearest demonstration, with the number of"
            f" targets; trained in {engine_title(engine)},"
            f" {amount((len(row.seeds) for row in own), 'seed')}."
            " Dashed: the demonstrator.",
        )


def _draw(rows: Sequence[Row], path: Path) -> None:
    """Draw a panel for each task and space."""
    panels: dict[str, list[Row]] = {}
    for row in rows:
        panels.setdefault(f"{row.task}, {SPACES[row.space]}", []).append(row)
    columns = min(_COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    with drawn(path, (3.1 * columns + 0.4, 2.6 * lines + 0.7), "constrained") as figure:
        grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes, (title, some) in zip(grid.flat, panels.items(), strict=False):
            for row in some:
                points = [
                    (i, found.value) for i, (_, found) in enumerate(row.bins) if found is not None
                ]
                style = "--" if row.setting.algorithm == JACOBIAN else "-"
                color, name = (
                    algorithm_color(row.setting.algorithm),
                    algorithm_title(row.setting.algorithm),
                )
                axes.plot(
                    *np.transpose(points),
                    ls=style,
                    color=color,
                    lw=1.6,
                    marker="o",
                    ms=3.5,
                    label=name,
                )
            labels = [
                f"{name}\n{count}" for name, (count, _) in zip(_TICKS, some[0].bins, strict=True)
            ]
            axes.set_xticks(range(len(labels)), labels)
            axes.set_title(title)
            tidy(axes)
        for axes in grid[:, 0]:
            axes.set_ylabel("success")
        for axes in grid.flat[max(0, len(panels) - columns) : len(panels)]:
            axes.set_xlabel("mm to a demonstration; targets")
        legend(figure, 5)


def distances(robot: Robot, space: str, num: int) -> NDArray[np.float64]:
    """Return how far held-out targets are from the nearest demonstration's, shape (num,), in [m].

    Args:
        robot: the study's.
        space: one whose demonstrations are those of Anchor Space.
        num: how many targets, as they are drawn at once.
    """
    shown = demonstration_targets(robot, DEMONSTRATIONS)
    targets = make_space(space, robot, shown).sample(np.random.default_rng(TEST_SEED), num)
    return np.linalg.norm(targets[:, None] - shown, axis=-1).min(axis=1)


def _as_shown(run: Run) -> bool:
    """Return whether a run has ten demonstrations and an unchanged algorithm, or none at all."""
    s = run.setting
    plain = (
        s.preset == "tuned"
        and s.num_demonstrations == DEMONSTRATIONS
        and not s.changes
        and not s.randomized
    )
    return s.space in TOLD and (plain or s.algorithm == JACOBIAN)
