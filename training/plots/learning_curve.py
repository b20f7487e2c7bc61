"""Draw how runs learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json
from cdcsr.plots import COLORS, SOFT, drawn, short_count
from training.algorithms.registry import algorithm_title
from training.run.metrics import read_metrics

Array = NDArray[np.float64]


def draw_learning_curve(
    runs: Sequence[Path], path: Path, references: Mapping[str, float] | None = None
) -> None:
    """Draw success on validation targets against environment steps, with its 95 % interval.

    Args:
        runs: folders of training runs; those not evaluated yet are left out.
        path: the PNG to write.
        references: success rates to compare with, by label; each is a horizontal line.

    Raises:
        CdcsrError: none of the runs has been evaluated yet.
    """
    histories = {
        run: [row for row in read_metrics(run / "metrics.csv") if "success_rate" in row]
        for run in runs
    }
    histories = {run: rows for run, rows in histories.items() if rows}
    if not histories:
        found = ", ".join(map(str, runs)) or "none given"
        raise CdcsrError(f"No run has metrics to draw yet: {found}.")
    with drawn(path, (6.4, 3.6)) as figure:
        axes = figure.add_subplot()
        for (run, rows), color in zip(histories.items(), cycle(COLORS), strict=False):
            steps, rate, low, high = (
                np.array([row[name] for row in rows])
                for name in ("environment_steps", "success_rate", "success_low", "success_high")
            )
            axes.fill_between(steps, low, high, color=color, alpha=0.15, lw=0)
            label = f"{_run_title(run)} ({rows[-1]['minutes']:.1f} min)"
            axes.plot(
                steps, rate, clip_on=False, color=color, lw=2, marker="o", ms=3.5, label=label
            )
        levels = (references or {}).items()
        for (label, rate), dashes in zip(levels, cycle(("--", ":", "-.")), strict=False):
            label = f"{label}: {rate:.2f}"
            axes.axhline(rate, color=SOFT, lw=1.3, ls=dashes, label=label, zorder=1)
        axes.set(xlabel="environment steps", ylabel="success on validation targets", ylim=(0, 1.02))
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(short_count)
        axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        axes.grid(axis="y")
        _add_updates_axis(axes, list(histories.values()))
        axes.legend(loc="best", fontsize=9)


def _add_updates_axis(axes: Axes, histories: Sequence[Sequence[Mapping[str, float]]]) -> None:
    """Add a scale in updates, if all runs take the same number of environment steps an update."""
    ratios = {
        round(row["environment_steps"] / row["update"], 6)
        for rows in histories
        for row in rows
        if row["update"]
    }
    if len(ratios) != 1:
        return
    (ratio,) = ratios
    top = axes.secondary_xaxis(
        "top", functions=(partial(np.multiply, 1 / ratio), partial(np.multiply, ratio))
    )
    top.set_xlabel("updates")
    top.xaxis.set_major_formatter(short_count)


def _run_title(run: Path) -> str:
    """Return what a run trained, or its folder's name if that cannot be read."""
    try:
        config = read_json(run / "config.json")
        name = f"{algorithm_title(config['algorithm'])} {config['preset']}"
        return f"{name}, {config['space']}, seed {config['seed']}"
    except (CdcsrError, KeyError):
        return run.name
