"""Figures: how a run learned, and which targets are reached. Drawn to files, without a display."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MaxNLocator, PercentFormatter
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.plots import COLORS, INK, SOFT, drawn
from cdcsr.robot.description import Robot
from training.measure.evaluation import Result
from training.plots.style import PALE, algorithm_title, short_count
from training.run.metrics import read_metrics

Array = NDArray[np.float64]

REACHED_COLOR, MISSED_COLOR = "#23945a", "#d0323f"
_ELEVATION, _AZIMUTH = 16, -58


def learning_curve(
    runs: Sequence[Path], path: Path, references: Mapping[str, float] | None = None
) -> None:
    """Success rate on validation targets against environment steps, with its 95 % interval.

    Args:
        runs: folders of training runs.
        path: the PNG to write.
        references: success rates to compare with, drawn as level lines, by their labels.

    Raises:
        CdcsrError: none of the runs has been evaluated yet.
    """
    histories = {
        run: [row for row in read_metrics(run / "metrics.csv") if "success_rate" in row]
        for run in runs
    }
    histories = {run: rows for run, rows in histories.items() if rows}
    if not histories:
        raise CdcsrError(
            f"No run has metrics to draw yet: {', '.join(map(str, runs)) or 'none given'}."
        )
    with drawn(path, (6.4, 3.6)) as figure:
        axes = figure.add_subplot()
        for (run, rows), color in zip(histories.items(), cycle(COLORS), strict=False):
            steps, low, high = (
                _column(rows, name) for name in ("environment_steps", "success_low", "success_high")
            )
            axes.fill_between(steps, low, high, color=color, alpha=0.15, lw=0)
            line = {"color": color, "lw": 2, "marker": "o", "ms": 3.5, "label": _label(run, rows)}
            axes.plot(steps, _column(rows, "success_rate"), clip_on=False, **line)
        for (label, rate), dashes in zip(
            (references or {}).items(), cycle(("--", ":", "-.")), strict=False
        ):
            axes.axhline(
                rate, color=SOFT, lw=1.3, ls=dashes, label=f"{label}: {rate:.2f}", zorder=1
            )
        axes.set(xlabel="environment steps", ylabel="success on validation targets", ylim=(0, 1.02))
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(short_count)
        axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        _updates_axis(axes, list(histories.values()))
        axes.legend(loc="best", fontsize=9)


def targets_picture(results: Mapping[str, Result], robot: Robot, path: Path) -> None:
    """Where the targets are, and which are reached: the whole robot, then one close view for each result.

    Args:
        results: of any controllers in any engines, by the titles of their panels.
        robot: drawn straight, for orientation.
        path: the PNG to write.

    Raises:
        CdcsrError: there are no results.
    """
    if not results:
        raise CdcsrError("There are no results to draw.")
    everything = np.concatenate([result.targets for result in results.values()])
    low, high = everything.min(axis=0), everything.max(axis=0)
    columns = min(2, len(results))
    rows = -(-len(results) // columns)
    height = 1.1 + 3.1 * rows
    with drawn(path, (1.9 + 3.1 * columns, height)) as figure:
        grid = figure.add_gridspec(
            rows,
            columns + 1,
            width_ratios=[0.6] + [1] * columns,
            left=0.0,
            right=0.98,
            bottom=0.6 / height,
            top=1 - 0.25 / height,
            wspace=0.0,
            hspace=0.08,
        )
        overview = _space(figure, grid[:, 0])
        span = 2 * robot.top + robot.arm_length
        _frame(
            overview,
            np.array([0.0, 0.0, robot.arm_length / 2]),
            span * np.array([0.22, 0.22, 0.55]),
            zoom=2,
        )
        _draw_robot(overview, robot)
        overview.scatter(*everything.T, s=2, color=INK, lw=0, depthshade=False)
        for artist in (*overview.lines, *overview.collections):
            artist.set_clip_on(
                False
            )  # a 3D view is square, and the robot higher than its column is wide
        overview.set_axis_off()
        for i, (name, result) in enumerate(results.items()):
            axes = _space(figure, grid[i // columns, 1 + i % columns])
            title = f"{textwrap.fill(name, 44)}\n{int(result.success.sum())} of {len(result.success)} reached"
            axes.set_title(title, y=0.95, fontsize=9)
            _frame(axes, (low + high) / 2, np.full(3, 0.52 * (high - low).max() + 1e-3))
            _draw_arm(axes, robot)
            _draw_targets(axes, result)
            for axis, letter in ((axes.xaxis, "x"), (axes.yaxis, "y"), (axes.zaxis, "z")):
                axis.set_major_locator(MaxNLocator(3))
                axis.set_label_text(f"{letter} [m]")
                axis.labelpad = -4
        handles = {
            label: handle
            for axes in figure.axes
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(
            list(handles.values()), list(handles), loc="lower left", bbox_to_anchor=(0.02, 0.0)
        )


def _draw_targets(axes: Axes3D, result: Result) -> None:
    reached, missed = result.targets[result.success], result.targets[~result.success]
    shadow = np.column_stack(
        [result.targets[:, :2], np.full(len(result.targets), axes.get_zlim()[0])]
    )
    axes.scatter(
        *shadow.T, s=5, color=PALE, lw=0, depthshade=False
    )  # on the floor, to see how deep a point lies
    axes.scatter(*reached.T, s=14, color=REACHED_COLOR, lw=0, depthshade=False, label="reached")
    axes.scatter(
        *missed.T, s=26, color=MISSED_COLOR, marker="x", lw=1.6, depthshade=False, label="missed"
    )


def _draw_robot(axes: Axes3D, robot: Robot) -> None:
    """The base as a box in outline, and the straight arm."""
    x, y, z = (edge / 2 for edge in robot.base.size)
    around = np.array([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)])
    for height in (-z, z):
        axes.plot(around[:, 0], around[:, 1], np.full(5, height), color=SOFT, lw=1)
    for corner in around[:4]:
        axes.plot([corner[0]] * 2, [corner[1]] * 2, [-z, z], color=SOFT, lw=1)
    _draw_arm(axes, robot)


def _draw_arm(axes: Axes3D, robot: Robot) -> None:
    """The straight arm and its joints, as far as they lie within the axes."""
    joints = robot.top + np.cumsum([0.0] + [link.length for link, _ in robot.links])
    low, high = axes.get_zlim()
    inside = joints[(joints >= low) & (joints <= high)]
    line = np.clip([joints[0], joints[-1]], low, high)
    axes.plot([0, 0], [0, 0], line, color=PALE, lw=2.5, solid_capstyle="round")
    axes.plot(
        np.zeros(len(inside)), np.zeros(len(inside)), inside, color=SOFT, lw=0, marker="o", ms=3
    )


def _space(figure: Figure, place: SubplotSpec) -> Axes3D:
    axes = figure.add_subplot(place, projection="3d")
    assert isinstance(axes, Axes3D)
    axes.view_init(_ELEVATION, _AZIMUTH)
    panes: tuple[Any, ...] = (axes.xaxis, axes.yaxis, axes.zaxis)
    for axis in panes:
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.tick_params(labelsize=8, pad=-2)
    return axes


def _frame(axes: Axes3D, center: Array, half: Array, zoom: int = 1) -> None:
    """Show a cuboid, with equal scales along all axes."""
    axes.set_xlim(center[0] - half[0], center[0] + half[0])
    axes.set_ylim(center[1] - half[1], center[1] + half[1])
    axes.set_zlim(center[2] - half[2], center[2] + half[2])
    axes.set_box_aspect(tuple(half / half.max()), zoom=zoom)


def _updates_axis(axes: Axes, histories: Sequence[list[dict[str, float]]]) -> None:
    """A second scale, in updates, if all runs take the same number of environment steps for each."""
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


def _label(run: Path, rows: Sequence[Mapping[str, float]]) -> str:
    try:
        config = json.loads((run / "config.json").read_text("utf-8"))
        name = f"{algorithm_title(config['algorithm'])} {config['preset']}, {config['space']}, seed {config['seed']}"
    except (OSError, ValueError, KeyError):
        name = run.name
    return f"{name} ({rows[-1]['minutes']:.1f} min)"


def _column(rows: Sequence[Mapping[str, float]], name: str) -> Array:
    return np.array([row[name] for row in rows])
