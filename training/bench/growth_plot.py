"""Figure: how the cost of a step grows with the robot. Drawn to a file, without a display."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from cdcsr.files import write_bytes
from cdcsr.plots import GRID_STYLE
from training.bench.scaling import Growth

_COLORS = {"mujoco": "#1f5fa8", "pybullet": "#d9822b"}
_OTHER = "#2f8f83"


def growth_picture(by_engine: Mapping[str, Growth], path: Path) -> None:
    """Microseconds of a step against links and segments, measured (marks) and fitted (lines), both logarithmic.

    Args:
        by_engine: measurements by the engine's name.
        path: the PNG to write.
    """
    with matplotlib.rc_context(GRID_STYLE):
        figure = Figure(figsize=(9.4, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for engine, growth in by_engine.items():
            color = _COLORS.get(engine, _OTHER)
            _curve(left, growth.links, growth.links_exponent, color, engine, "links")
            _curve(right, growth.segments, growth.segments_exponent, color, engine, "segments")
        left.set(xlabel="links, in two segments", ylabel="time of a step of one copy [µs]")
        right.set(xlabel="segments, of twelve links in all; four cables each")
        figure.suptitle(
            "Cost of a step against the size of the robot, and the power that fits best",
            fontsize=11,
        )
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=150)
    write_bytes(path, data.getvalue())


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
    axes.xaxis.set_major_locator(FixedLocator(sizes.tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(loc="upper left")
