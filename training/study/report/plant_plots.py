"""Figures of moving targets (Fig. 6), and of plants that differ from the description."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from cdcsr.plots import SOFT, drawn
from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import algorithm_color
from training.config.run_description import RunDescription
from training.measure.plant_axes import AXES
from training.measure.statistics import Sweep, wilson
from training.study.report.cells import amount, who
from training.study.report.learning_curves import Figures, legend, tidy
from training.study.report.plant_sweeps import sweeps
from training.study.report.records import SPACES, Run, grouped
from training.study.report.table_parts import engines_of

Array = NDArray[np.float64]

_FOLLOWED = {
    "base_position_error": ("base position [mm]", 1000.0, 3.0),
    "base_attitude_error": ("base attitude [rad]", 1.0, 0.05),
    "tip_error": ("tip to target [mm]", 1000.0, 30.0),
}
"""Title, factor to its unit, and the paper's bound in that unit (section V-F; for the tip, the
threshold of success)."""
_ROOM = 4
"""Errors above this many times their bound are not drawn: a policy that loses the target must not
hide the others."""
_COLUMNS = 4


def follow_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw Fig. 6 for each task, space and engine of training; tested in that engine."""
    kinds: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        if run.follow is not None:
            kinds.setdefault((run.setting.task, run.setting.space, run.setting.backend), []).append(
                run
            )
    for (task, space, engine), chosen in sorted(kinds.items()):
        groups, title = grouped(chosen), engine_title(engine)
        motions = sorted({str(x) for run in chosen if run.follow for x in run.follow["motion"]})
        file = (
            f"fig6-{space}-{engine}.png" if task == "reach" else f"fig6-{task}-{space}-{engine}.png"
        )
        with drawn(out / file, (3.6 * len(motions) + 0.5, 6.4), "constrained") as figure:
            grid = figure.subplots(
                len(_FOLLOWED), len(motions), sharex=True, sharey="row", squeeze=False
            )
            for row, (name, (label, factor, bound)) in zip(grid, _FOLLOWED.items(), strict=True):
                row[0].set_ylabel(label)
                for axes, motion in zip(row, motions, strict=True):
                    for setting, group in groups.items():
                        _followed(axes, setting, group, engine, motion, name, factor)
                    axes.axhline(bound, color=SOFT, lw=1.2, ls=":", label="bound")
                    axes.set_ylim(0, min(axes.get_ylim()[1], _ROOM * bound))
                    axes.grid(axis="y")
            for axes, motion in zip(grid[0], motions, strict=True):
                axes.set_title(motion)
            for axes in grid[-1]:
                axes.set_xlabel("simulation steps")
            legend(figure, 3)
        yield (
            file,
            (
                f"Fig. 6: following a moving target; trained to {task} in"
                f" {SPACES.get(space, space)} Space in {title},"
                f" {amount(map(len, groups.values()), 'seed')}. Mean over episodes and seeds, and"
                " the range of nine tenths; dotted, the paper's bounds on the base, and the"
                f" threshold of success; what leaves a panel is more than {_ROOM} times that."
            ),
        )


def plant_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw success along every axis of the plant, for each engine and space of the test."""
    swept = [run for run in runs if "plants" in run.evaluations]
    for engine in engines_of(swept, "plants"):
        title = engine_title(engine)
        for space in SPACES:
            found = {
                axis: {
                    s: list(one.values())
                    for s, g in grouped(swept).items()
                    if (one := sweeps(g, axis, engine, space))
                }
                for axis in AXES
            }
            found = {axis: groups for axis, groups in found.items() if groups}
            if found:
                file = f"plants-{space}-{engine}.png"
                _draw_sweeps(found, out / file)
                sizes = [len(seeds) for groups in found.values() for seeds in groups.values()]
                yield (
                    file,
                    (
                        f"Success in {title}, {SPACES[space]} Space, on plants that differ from the"
                        f" description; {amount(sizes, 'seed')}. Bands are Wilson intervals over"
                        " the episodes of all seeds together; only levels that every seed was"
                        " measured at. Dashed: trained on randomized plants."
                    ),
                )


def common(seeds: Sequence[Sweep]) -> tuple[Array, Array]:
    """Return success at the levels that every seed was measured at.

    Returns:
        Levels, (L,), and successes and episodes at each over all seeds together, (L, 2).
    """
    levels = sorted(
        set[float]()
        .union(*(one.levels for one in seeds))
        .intersection(*(one.levels for one in seeds))
    )
    counts = [
        [
            sum(int(one.outcomes[:, one.levels == level].sum()) for one in seeds),
            sum(len(one.outcomes) for one in seeds),
        ]
        for level in levels
    ]
    return np.array(levels), np.array(counts)


def _draw_sweeps(found: dict[str, dict[RunDescription, list[Sweep]]], path: Path) -> None:
    columns = min(_COLUMNS, len(found))
    rows = -(-len(found) // columns)
    with drawn(path, (2.7 * columns + 0.4, 2.3 * rows + 0.7), "constrained") as figure:
        grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for row in grid:
            row[0].set_ylabel("success")
        for axes in grid.flat[len(found) :]:
            axes.set_axis_off()
        for axes, (axis, groups) in zip(grid.flat, found.items(), strict=False):
            for setting, seeds in groups.items():
                levels, counts = common(seeds)
                bounds = np.array([wilson(int(s), int(n)) for s, n in counts]).reshape(-1, 2)
                color = algorithm_color(setting.algorithm)
                axes.fill_between(levels, *bounds.T, color=color, alpha=0.12, lw=0)
                line = {
                    "color": color,
                    "lw": 1.5,
                    "marker": "o",
                    "ms": 3,
                    "ls": "--" if setting.randomize else "-",
                }
                axes.plot(levels, counts[:, 0] / counts[:, 1], label=who(setting), **line)
            axes.set_xlabel(AXES[axis].title)
            axes.axvline(AXES[axis].nominal, color=SOFT, lw=0.8, ls=":")
            if AXES[axis].unit == "factor":
                _factors(axes)
            else:
                axes.xaxis.set_major_locator(MaxNLocator(4, steps=(1, 2, 5, 10)))
            tidy(axes)
        legend(figure, min(4, columns + 1))


def _factors(axes: Axes) -> None:
    """A logarithmic scale of factors, with plain numbers on it."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    wide, narrow = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100), (0.125, 0.25, 0.5, 1, 2, 4, 8)
    ticks = [x for x in (wide if high / low > 12 else narrow) if low <= x <= high]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))


def _followed(
    axes: Axes,
    setting: RunDescription,
    group: Sequence[Run],
    engine: str,
    motion: str,
    name: str,
    factor: float,
) -> None:
    samples: dict[int, list[float]] = {}
    for run in group:
        if run.follow is not None:
            chosen = (run.follow["backend"] == engine) & (run.follow["motion"] == motion)
            for step, value in zip(
                run.follow["step"][chosen], run.follow[name][chosen], strict=True
            ):
                samples.setdefault(int(step), []).append(factor * float(value))
    if samples:
        steps = sorted(samples)
        color = algorithm_color(setting.algorithm)
        low, high = np.array([np.quantile(samples[step], (0.05, 0.95)) for step in steps]).T
        axes.fill_between(steps, low, high, color=color, alpha=0.12, lw=0)
        axes.plot(
            steps,
            [np.mean(samples[step]) for step in steps],
            color=color,
            lw=1.6,
            label=who(setting),
        )
