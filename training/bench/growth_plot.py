"""Figure: how the cost of a step grows with the robot. Drawn to a file, without a display."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from cdcsr.plots import COLORS, drawn
from training.bench.scaling import Growth


def growth_picture(by_engine: Mapping[str, Growth], path: Path) -> None:
    """Microseconds of a step against links and segments, measured (marks) and fitted (lines), both logarithmic.

    Args:
        by_engine: measurements by the engine's name.
        path: the PNG to write.
    """
    with drawn(path, (9.4, 4.2), "constrained") as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for (engine, growth), color in zip(by_engine.items(), COLORS, strict=False):
            _curve(left, growth.links, growth.links_exponent, color, engine, "links")
            _curve(right, growth.segments, growth.segments_exponent, color, engine, "segments")
        left.set(xlabel="links, in two segments", ylabel="time of a step of one copy [µs]")
        right.set(xlabel="segments, of twelve links in all; four cables each")
        figure.suptitle(
            "Cost of a step against the size of the robot, and the power that fits best",
            fontsize=11,
        )


def _curve(
    axes: Axes, microseconds: Mapping[int, float], exponent: float, color: str, engine: str, of: str
) -> None:
    sizes, values = np.array(list(microseconds)), np.array(list(microseconds.values()))
    axes.plot(sizes, values, "o", color=color, markersize=6)
    middle = np.exp(np.log(values).mean() - exponent * np.log(sizes).mean())
    axes.plot(
        sizes,
        middle * sizes**exponent,
        color=color,
        linewidth=1.4,
        label=f"{engine}: {of}^{exponent:.2f}",
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid()
    axes.xaxis.set_major_locator(FixedLocator(sizes.tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(loc="upper left")
