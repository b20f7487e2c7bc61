"""Learning curves of the study: Figs. 3 to 5 of the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from cdcsr.plots import drawn, short_count
from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import algorithm_color, algorithm_title
from training.config.run_description import RunDescription
from training.measure.statistics import band
from training.study.declare.grid import ABLATIONS
from training.study.report.cells import (
    amount,
    measure,
    who,
)
from training.study.report.records import JACOBIAN, SPACES, Run, grouped, is_plain
from training.study.report.tables import COUNTED, counted

Array = NDArray[np.float64]

Figures = Iterator[tuple[str, str]]
"""The name of each figure's file, drawn into a folder `out`, and its caption."""
Panels = dict[str, dict[RunDescription, list[Run]]]
"""Groups of seeds by the titles of their panels."""


def curve_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw the learning curves of every preset and engine."""
    plain = [run for run in runs if is_plain(run.setting) and run.setting.algorithm != JACOBIAN]
    chosen: tuple[tuple[str, str, list[Run], Callable[[RunDescription], str]], ...] = (
        (
            "fig3",
            "Fig. 3: training",
            [run for run in plain if run.setting.algorithm not in ABLATIONS[1:]],
            _by_space,
        ),
        (
            "fig4",
            "Fig. 4: ablations of BATD3",
            [r for r in plain if r.setting.algorithm in ABLATIONS],
            _by_space,
        ),
        ("fig5", "Fig. 5: number of demonstrations, Anchor Space", counted(runs), _by_algorithm),
    )
    for name, title, some, panel in chosen:
        for (preset, engine, updates), part in sorted(_by_kind(some).items()):
            varied = [
                (r.setting.algorithm, r.setting.changes, r.setting.num_demonstrations) for r in part
            ]
            if (name != "fig3" or updates) and len(
                {(one if name != "fig5" else one[2]) for one in varied}
            ) < 2:
                continue  # there is nothing to compare
            panels: Panels = {}
            for setting, group in grouped(part).items():
                panels.setdefault(panel(setting), {})[setting] = group
            file = f"{name}-{preset}-{engine}{f'-u{updates}' if updates else ''}.png"
            _draw(panels, out / file, counts=name == "fig5")
            length = f", {updates} updates" if updates else ""
            yield (
                file,
                f"{title}; preset {preset}, trained in {engine_title(engine)}{length}."
                f" {_caption(part)}",
            )


def _caption(runs: Sequence[Run]) -> str:
    """Say what curves rest on."""
    minutes = np.mean([run.minutes for run in runs])
    seeds = amount(map(len, grouped(runs).values()), "seed")
    return (
        f"Success on validation targets: mean over seeds ({seeds} a curve) and its 95 % bootstrap"
        " interval, of few seeds about their range, at updates that all seeds have reached;"
        f" {minutes:.1f} minutes a run. A level line is an algorithm without a learning"
        " curve, at its success on held-out targets."
    )


def aligned(runs: Sequence[Run]) -> tuple[Array, Array]:
    """The learning curves of some seeds, at the updates all of them were measured at.

    Returns:
        Updates, (P,), and success rates, (seeds with a curve, P); P is 0 if there is no curve.
    """
    curves = [run.curve for run in runs if run.curve]
    updates = sorted(set[float]().union(*curves).intersection(*curves))
    return np.array(updates), np.array([[curve[x] for x in updates] for curve in curves])


def tidy(axes: Axes) -> None:
    """A vertical axis of success rates."""
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axes.grid(axis="y")
    axes.set_axisbelow(True)


def legend(figure: Figure, columns: int) -> None:
    """One legend for all panels, below them; each label once."""
    handles = {
        label: handle
        for axes in figure.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=columns, fontsize=9
    )


def _draw(panels: Panels, path: Path, counts: bool) -> None:
    """Draw a panel of curves for each title; with `counts`, also success by demonstrations.

    That one also has the algorithms without learning curves, which then have no panel of their own.
    """
    shown = {
        title: g
        for title, g in panels.items()
        if not counts or any(r.curve for some in g.values() for r in some)
    }
    total = len(shown) + counts
    looks = _looks(panels, counts)
    rows = -(-len(looks) // min(5, 2 * total))  # of the legend
    with drawn(path, (3.1 * total + 0.5, 2.9 + 0.2 * rows), "constrained") as figure:
        grid = figure.subplots(1, total, sharey=True, squeeze=False)[0]
        for axes, (title, groups) in zip(grid, shown.items(), strict=False):
            axes.set(title=title, xlabel="updates")
            for setting, group in groups.items():
                _draw_curve(
                    axes, setting, group, _label(setting, counts), *looks[_label(setting, counts)]
                )
            axes.xaxis.set_major_formatter(short_count)
            tidy(axes)
        widest = max(
            axes.get_xlim()[1] for axes in grid[: len(shown)]
        )  # one may have level lines alone
        for axes in grid[: len(shown)]:
            axes.set_xlim(0, widest)
        grid[0].set_ylabel("success on validation targets")
        if counts:
            _by_count(grid[-1], panels)
        legend(figure, min(5, 2 * total))


def _draw_curve(
    axes: Axes,
    setting: RunDescription,
    group: Sequence[Run],
    label: str,
    color: object,
    dashes: str,
) -> None:
    """The mean of seeds and its interval; a level line for what has no learning curve."""
    updates, curves = aligned(group)
    if len(updates):
        middle, low, high = band(curves)
        axes.fill_between(updates, low, high, color=color, alpha=0.15, lw=0)
        axes.plot(updates, middle, color=color, lw=1.8, ls=dashes, label=label)
        return
    cell = measure(group, "nominal", space=setting.space)
    if cell:
        axes.axhspan(cell.success.low, cell.success.high, color=color, alpha=0.1, lw=0)
        axes.axhline(cell.success.value, color=color, lw=1.3, ls=":", label=label)


def _by_count(axes: Axes, panels: Panels) -> None:
    """Success on held-out targets against the number of demonstrations."""
    axes.set(title="after training, held-out targets", xlabel="demonstrations")
    for algorithm in COUNTED:
        groups = [
            (s, g)
            for groups in panels.values()
            for s, g in groups.items()
            if s.algorithm == algorithm
        ]
        cells = {s.num_demonstrations: measure(g, "nominal", space="anchor") for s, g in groups}
        points = [(count, cell.success) for count, cell in sorted(cells.items()) if cell]
        if points:
            counts, values = (
                np.array([x for x, _ in points]),
                np.array([e.value for _, e in points]),
            )
            spread = np.abs(np.array([[e.low, e.high] for _, e in points]).T - values)
            style = {
                "color": algorithm_color(algorithm),
                "marker": "o",
                "ms": 4,
                "lw": 1.5,
                "capsize": 2.5,
            }
            axes.errorbar(counts, values, spread, label=algorithm_title(algorithm), **style)
    axes.set_xticks(sorted({s.num_demonstrations for groups in panels.values() for s in groups}))
    tidy(axes)


def _looks(panels: Panels, counts: bool) -> dict[str, tuple[object, str]]:
    """Return colour and dashes by label: by algorithm, or by the number of demonstrations."""
    settings = [setting for groups in panels.values() for setting in groups]
    if counts:
        numbers = sorted({setting.num_demonstrations for setting in settings})
        shades = matplotlib.colormaps["viridis_r"](np.linspace(0.2, 0.95, len(numbers)))
        return {
            _count_label(number): (shade, "-")
            for number, shade in zip(numbers, shades, strict=True)
        }
    return {
        _label(setting, counts): (
            algorithm_color(setting.algorithm),
            "--" if setting.algorithm == "drldr" else "-",
        )
        for setting in settings
    }


def _label(setting: RunDescription, counts: bool) -> str:
    return _count_label(setting.num_demonstrations) if counts else who(setting)


def _count_label(number: int) -> str:
    return f"{number} demonstrations"


def _by_space(setting: RunDescription) -> str:
    return f"{SPACES[setting.space]} Space"


def _by_algorithm(setting: RunDescription) -> str:
    return algorithm_title(setting.algorithm)


def _by_kind(runs: Sequence[Run]) -> dict[tuple[str, str, int], list[Run]]:
    """Group runs by preset, engine and updates; the usual number of updates counts as 0."""
    lengths = Counter(
        (run.setting.preset, run.setting.backend, run.setting.updates) for run in runs
    )
    usual: dict[tuple[str, str], int] = {}
    for (preset, engine, updates), _ in lengths.most_common():
        usual.setdefault((preset, engine), updates)
    kinds: dict[tuple[str, str, int], list[Run]] = {}
    for run in runs:
        kind, updates = (run.setting.preset, run.setting.backend), run.setting.updates
        kinds.setdefault((*kind, 0 if updates == usual[kind] else updates), []).append(run)
    return kinds
