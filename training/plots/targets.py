"""Draw which targets are reached."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axis3d import Axis
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.plots import COLORS, INK, SOFT, drawn
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import tip_at_start
from cdcsr.tasks.workspace_map import Workspace
from training.measure.evaluation import Result

Array = NDArray[np.float64]

REACHED_COLOR, MISSED_COLOR = "#23945a", "#d0323f"
_PALE = "#c9ccd1"
_VOLUME = "#7b4fa3"
"""The colour of a map, as in the live view."""
_ELEVATION, _AZIMUTH = 16, -58
"""Direction of view, in degrees."""


def draw_targets(results: Mapping[str, Result], robot: Robot, path: Path) -> None:
    """Draw where the targets are and which are reached: the whole robot, then a near view a result.

    Args:
        results: by the titles of their panels.
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
        _draw_overview(_add_axes(figure, grid[:, 0]), robot, everything)
        for i, (name, result) in enumerate(results.items()):
            axes = _add_axes(figure, grid[i // columns, 1 + i % columns])
            count = f"{int(result.success.sum())} of {len(result.success)} reached"
            axes.set_title(f"{textwrap.fill(name, 44)}\n{count}", y=0.95, fontsize=9)
            _frame(
                axes,
                (low + high) / 2,
                np.full(3, 0.52 * (high - low).max() + 4e-4 * robot.arm_length),
            )
            _draw_arm(axes, robot)
            _draw_result(axes, result)
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


def draw_workspace(
    results: Mapping[str, Result], workspace: Workspace, robot: Robot, path: Path
) -> None:
    """Draw a map of the workspace as a translucent body, seen from two sides, and in it which
    targets were reached; a row a result.

    Args:
        results: by the titles of their rows; without any the map is drawn alone.
        workspace: the map.
        robot: drawn straight.
        path: the PNG or PDF to write.
    """
    hull = workspace.hull
    corners = np.concatenate(
        [hull.reshape(-1, 3), *(result.targets for result in results.values())]
    )
    tip = tip_at_start(robot)
    low, high = (edge(np.vstack([corners, tip]), axis=0) for edge in (np.min, np.max))
    rows = results or {"": None}
    height = 3.9 * len(rows) + 0.3
    with drawn(path, (8.2, height)) as figure:
        grid = figure.add_gridspec(
            len(rows),
            2,
            left=0.0,
            right=0.96,
            bottom=0.4 / height,
            top=1.0,
            wspace=0.16,
            hspace=0.1,
        )
        for row, (name, result) in enumerate(rows.items()):
            for column, azimuth in enumerate((_AZIMUTH, _AZIMUTH + 90)):
                axes = _add_axes(figure, grid[row, column])
                axes.view_init(_ELEVATION, azimuth)
                axes.computed_zorder = False
                _frame(axes, (low + high) / 2, np.full(3, 0.52 * (high - low).max()))
                faces, edges = to_rgba(_VOLUME, 0.05), to_rgba(_VOLUME, 0.15)
                body = Poly3DCollection(hull, facecolor=faces, edgecolor=edges, linewidth=0.4)
                body.set_zorder(1)
                axes.add_collection3d(body)
                _draw_arm(axes, robot)
                if result is not None:
                    _draw_success(axes, result)
                for axis, letter in ((axes.xaxis, "x"), (axes.yaxis, "y"), (axes.zaxis, "z")):
                    axis.set_major_locator(MaxNLocator(4))
                    axis.set_label_text(f"{letter} [m]")
                    axis.labelpad = -3
            count = f"{len(workspace.cells)} cells of {robot.name}'s workspace"
            if result is not None:
                count = f"{name}\n{int(result.success.sum())} of {len(result.success)} reached"
            figure.text(0.5, 1 - (row + 0.03) * 3.9 / height, count, ha="center", va="top")
        marks, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(marks, labels, loc="lower center", ncols=3)


def _draw_success(axes: Axes3D, result: Result) -> None:
    """Draw reached and missed targets, which differ in colour and in shape."""
    blue, orange = COLORS[:2]
    reached, missed = result.targets[result.success], result.targets[~result.success]
    axes.scatter(*reached.T, s=12, color=blue, lw=0, depthshade=False, label="reached", zorder=3)
    axes.scatter(
        *missed.T,
        s=34,
        color=orange,
        marker="x",
        lw=1.8,
        depthshade=False,
        label="missed",
        zorder=4,
    )


def _draw_overview(axes: Axes3D, robot: Robot, targets: Array) -> None:
    """Draw the whole robot and the targets, (N, 3) in [m]."""
    span = 2 * robot.top + robot.arm_length
    center = np.array([0.0, 0.0, robot.arm_length / 2])
    _frame(axes, center, span * np.array([0.22, 0.22, 0.55]), zoom=2)
    _draw_robot(axes, robot)
    axes.scatter(*targets.T, s=2, color=INK, lw=0, depthshade=False)
    # A 3D view is square; the robot is higher than its column is wide.
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)
    axes.set_axis_off()


def _draw_result(axes: Axes3D, result: Result) -> None:
    """Draw reached and missed targets, and their shadows on the floor, which show their depth."""
    reached, missed = result.targets[result.success], result.targets[~result.success]
    floor = np.full(len(result.targets), axes.get_zlim()[0])
    shadow = np.column_stack([result.targets[:, :2], floor])
    axes.scatter(*shadow.T, s=5, color=_PALE, lw=0, depthshade=False)
    axes.scatter(*reached.T, s=14, color=REACHED_COLOR, lw=0, depthshade=False, label="reached")
    axes.scatter(
        *missed.T, s=26, color=MISSED_COLOR, marker="x", lw=1.6, depthshade=False, label="missed"
    )


def _draw_robot(axes: Axes3D, robot: Robot) -> None:
    """Draw the base as a box in outline, and the straight arm."""
    x, y, z = (edge / 2 for edge in robot.base.size)
    around = np.array([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)])
    for height in (-z, z):
        axes.plot(around[:, 0], around[:, 1], np.full(5, height), color=SOFT, lw=1)
    for corner in around[:4]:
        axes.plot([corner[0]] * 2, [corner[1]] * 2, [-z, z], color=SOFT, lw=1)
    _draw_arm(axes, robot)


def _draw_arm(axes: Axes3D, robot: Robot) -> None:
    """Draw the part of the straight arm and its joints that lies within the axes."""
    joints = robot.first_joint + np.cumsum([0.0] + [link.length for link, _ in robot.links])
    low, high = axes.get_zlim()
    inside = joints[(joints >= low) & (joints <= high)]
    zero = np.zeros(len(inside))
    line = np.clip([joints[0], joints[-1]], low, high)
    axes.plot([0, 0], [0, 0], line, color=_PALE, lw=2.5, solid_capstyle="round")
    axes.plot(zero, zero, inside, color=SOFT, lw=0, marker="o", ms=3)


def _add_axes(figure: Figure, place: SubplotSpec) -> Axes3D:
    axes = figure.add_subplot(place, projection="3d")
    axes.patch.set_visible(False)  # it would cover labels of the panel to the left
    assert isinstance(axes, Axes3D)
    axes.view_init(_ELEVATION, _AZIMUTH)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        assert isinstance(axis, Axis)
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.tick_params(labelsize=8, pad=-2)
    return axes


def _frame(axes: Axes3D, center: Array, half: Array, zoom: int = 1) -> None:
    """Show a box, given by its centre and half its edges in [m], at the same scale on all axes."""
    axes.set_xlim(center[0] - half[0], center[0] + half[0])
    axes.set_ylim(center[1] - half[1], center[1] + half[1])
    axes.set_zlim(center[2] - half[2], center[2] + half[2])
    axes.set_box_aspect(tuple(half / half.max()), zoom=zoom)
