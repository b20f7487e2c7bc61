"""Draw parity: one-step differences, convergence, and distance over time. Drawn to files,
without a display."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from backends.parity.one_step import QUANTITIES
from backends.parity.open_loop import DISTANCE, OpenLoop
from backends.parity.report import Parity
from backends.parity.trajectories import DEMONSTRATOR
from cdcsr.plots import COLORS, SOFT, drawn

_MARKERS = ("o", "D", "s", "^", "v")
_RED = "#c0392b"
_SMALLEST = 1e-12
"""Smaller differences are drawn as this, because a logarithmic scale has no zero."""


def draw(parity: Parity, folder: Path) -> list[Path]:
    """Draw all figures of a robot into a folder, and return the files."""
    figures: dict[str, Callable[[Figure, Parity], None]] = {
        "one-step": _one_step,
        "convergence": _convergence,
        "open-loop": _open_loop,
    }
    paths = []
    for name, paint in figures.items():
        paths.append(folder / f"{parity.robot.name}-{name}.png")
        size = (9.4, 5.8 if name == "one-step" else 4.2)
        with drawn(paths[-1], size, "constrained") as figure:
            paint(figure, parity)
    return paths


def _one_step(figure: Figure, parity: Parity) -> None:
    """Draw the distributions of the differences, a panel for each quantity."""
    title = f"{parity.robot.name}: difference after one step from the same state"
    figure.suptitle(title, fontsize=11)
    panels = figure.subplots(2, 2, sharey=True).ravel()
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        for i, part in enumerate(parity.one_step):
            values = np.sort(np.maximum(part.differences[quantity.name], _SMALLEST))
            share = np.arange(1, len(values) + 1) / len(values)
            color = COLORS[i % len(COLORS)]
            label = f"{part.pair}, {part.commands} ({len(values)} states)"
            axes.step(values, share, where="post", color=color, linewidth=1.6, label=label)
        size = max(float(np.percentile(part.sizes[quantity.name], 95)) for part in parity.one_step)
        axes.axvline(
            size, color=SOFT, linestyle=":", linewidth=1.4, label="the quantity itself, 95 %"
        )
        axes.set_xscale("log")
        axes.grid()
        axes.set_xlim(right=2 * size)
        axes.set_xlabel(f"{quantity.name} [{quantity.unit}]")
        axes.yaxis.set_major_formatter(PercentFormatter(1))
    for axes in panels[::2]:
        axes.set_ylabel("states below")
    _legend_below(figure, panels[0])


def _convergence(figure: Figure, parity: Parity) -> None:
    """Draw how far each engine is from its limit against the time step, a panel for each kind
    of commands."""
    title = f"{parity.robot.name}: distance from its limit as the time step shrinks"
    figure.suptitle(title, fontsize=11)
    panels = _panels(figure, parity.open_loop)
    for axes, part in zip(panels, parity.open_loop, strict=True):
        steps = 1e3 * part.time_steps
        for i, engine in enumerate(part.tips):
            # Engines that agree lie on each other: the first has large open marks, the others small
            # full ones.
            size, face = (10, "none") if i == 0 else (4.5, COLORS[i])
            axes.plot(
                steps,
                1e3 * part.errors(engine),
                _MARKERS[i % len(_MARKERS)] + "-",
                color=COLORS[i],
                markersize=size,
                markerfacecolor=face,
                linewidth=2.4 if i == 0 else 1.2,
                label=f"{engine} from its limit",
            )
        for i, engine in enumerate(list(part.tips)[1:], start=1):
            apart = 1e3 * np.maximum(part.mean_distance(engine), _SMALLEST)
            label = f"{engine} from {part.reference}"
            axes.plot(
                steps,
                apart,
                _MARKERS[i % len(_MARKERS)] + "--",
                color=COLORS[i],
                markersize=4.5,
                linewidth=1.2,
                label=label,
            )
        guide = 0.5e3 * part.errors(part.reference)[0] * part.time_steps / part.time_steps[0]
        axes.plot(steps, guide, color=SOFT, linestyle=":", linewidth=1.2, label="first order")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(steps.tolist()))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_xlabel("time step [ms]")
        orders = ", ".join(f"{engine} {part.order(engine):.2f}" for engine in part.tips)
        title = f"{part.commands} commands; order: {orders}"
        axes.set_title(textwrap.fill(title, 52, break_on_hyphens=False))
    panels[0].set_ylabel("tip distance, mean over time [mm]")
    _legend_below(figure, panels[0])


def _open_loop(figure: Figure, parity: Parity) -> None:
    """Draw the distance between engines over time at the default time step, and the noise floor."""
    title = "the same commands without feedback; median and range of the episodes"
    figure.suptitle(f"{parity.robot.name}: {title}", fontsize=11)
    panels = _panels(figure, parity.open_loop)
    for axes, part in zip(panels, parity.open_loop, strict=True):
        for i, engine in enumerate(list(part.tips)[1:], start=1):
            _band(
                axes, part, part.distance(engine)[0], COLORS[i], f"{engine} from {part.reference}"
            )
        _band(axes, part, part.noise, SOFT, f"{part.reference}, commands off by 1e-6 (noise floor)")
        if part.commands == DEMONSTRATOR:
            axes.axhline(
                1e3 * DISTANCE * part.arm_length,
                color=_RED,
                linestyle="--",
                linewidth=1.2,
                label="tolerance of the mean",
            )
        axes.set_xlabel("time [s]")
        axes.set_title(f"{part.commands} commands")
        axes.set_xlim(0, part.time[-1])
    panels[0].set_ylabel("distance of the tips [mm]")
    _legend_below(figure, panels[0])


def _band(axes: Axes, part: OpenLoop, distance: np.ndarray, color: str, label: str) -> None:
    """Draw the median over the episodes that have not ended, and their range."""
    running = ~np.isnan(distance)
    alive = running.any(axis=1)
    values = 1e3 * np.maximum(distance[alive], _SMALLEST)
    time = part.time[alive]
    axes.fill_between(
        time,
        np.nanmin(values, axis=1),
        np.nanmax(values, axis=1),
        color=color,
        alpha=0.2,
        linewidth=0,
    )
    axes.plot(time, np.nanmedian(values, axis=1), color=color, linewidth=1.6, label=label)


def _legend_below(figure: Figure, axes: Axes) -> None:
    """Draw one legend for all panels, below them."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(4, len(labels)), fontsize=8.5
    )


def _panels(figure: Figure, parts: Sequence[OpenLoop]) -> list[Axes]:
    panels = list(figure.subplots(1, len(parts), sharey=True, squeeze=False)[0])
    for axes in panels:
        axes.set_yscale("log")
        axes.grid()
    return panels
