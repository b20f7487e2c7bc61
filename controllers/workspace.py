"""Map a robot's workspace: the points that the scripted demonstrator reaches."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tasks.workspace_map import Workspace, cells_between
from controllers.jacobian import JacobianController
from controllers.rollout import rollout

Array = NDArray[np.float64]

BATCH = 128
"""The number of targets that are tried side by side."""
_NEIGHBOURS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])


def compute_workspace(
    robot: Robot,
    backend: str,
    spacing: float,
    frame_skip: int,
    progress: Callable[[int, int, int], None] = lambda *_: None,
) -> Workspace:
    """Try the points of a grid, from the middle of the robot's Anchor Space outwards.

    Each point that is reached has its neighbours tried too, so points that no path along reached
    points connects to the Anchor Space stay unknown.

    Args:
        robot: the description.
        backend: the engine.
        spacing: the distance between neighbours in the grid, in [m].
        frame_skip: how many simulation steps each of the demonstrator's commands is held for.
        progress: called after each batch with the numbers of points tried, of points reached, and
            of episodes that diverged.

    Raises:
        CdcsrError: the demonstrator reaches all corners of no cell of the grid.
    """
    middle = np.array(robot.workspace.center)
    reached: list[tuple[int, int, int]] = []
    waiting: list[tuple[int, int, int]] = [(0, 0, 0)]
    known = {(0, 0, 0)}
    controller = JacobianController(robot)
    tried = diverged = 0
    while waiting:
        batch, waiting = waiting[:BATCH], waiting[BATCH:]
        env = TaskVectorEnv(
            len(batch), robot, backend, frame_skip=frame_skip, autoreset_mode="Disabled"
        )
        try:
            observation, _ = env.reset(options={"targets": middle + spacing * np.array(batch)})
            done = rollout(controller, env, observation)
            success, diverged = done.success, diverged + done.diverged
        finally:
            env.close()
        tried += len(batch)
        for point in (p for p, yes in zip(batch, success, strict=True) if yes):
            reached.append(point)
            for x, y, z in (np.array(point) + _NEIGHBOURS).tolist():
                if (x, y, z) not in known:
                    known.add((x, y, z))
                    waiting.append((x, y, z))
        progress(tried, len(reached), diverged)
    cells, wide = cells_between(np.array(reached, dtype=np.int64).reshape(-1, 3))
    if len(cells) == 0:
        raise CdcsrError(
            f"The demonstrator reaches {len(reached)} of {tried} points {spacing:g} m apart around "
            f"the middle of the Anchor Space of {robot.name!r}, and no whole cell between them; "
            "take a smaller --spacing or move the robot's workspace."
        )
    edges = np.where(wide, spacing, 0.0)
    index = cells.astype(np.int16)
    return Workspace(robot.fingerprint, middle, edges, index, robot.to_toml())


def draw_workspace(workspace: Workspace, robot: Robot, path: Path) -> None:
    """Draw the cells of a map seen along each axis, darker where more lie behind each other."""
    from matplotlib.patches import Rectangle

    from cdcsr.plots import drawn

    with drawn(path, (12, 4.2), "constrained") as figure:
        axes = figure.subplots(1, 3)
        lowest, size = workspace.cells.min(axis=0), np.ptp(workspace.cells, axis=0) + 1
        for ax, (across, up, along) in zip(axes, ((0, 2, 1), (1, 2, 0), (0, 1, 2)), strict=True):
            counts = np.zeros(size[[up, across]])
            np.add.at(counts, tuple((workspace.cells - lowest)[:, [up, across]].T), 1)
            low = workspace.origin + lowest * workspace.edges
            high = low + size * workspace.edges
            image = ax.imshow(
                np.where(counts > 0, counts, np.nan),
                origin="lower",
                cmap="viridis_r",
                aspect="equal",
                extent=(low[across], high[across], low[up], high[up]),
            )
            margin = 0.1
            if up == 2:
                ax.plot([0, 0], [robot.top, robot.top + robot.arm_length], color="black", lw=2)
            ax.set_xlim(low[across] - margin, high[across] + margin)
            ax.set_ylim(low[up] - margin, high[up] + margin)
            center, edge = np.array(robot.workspace.center), np.array(robot.workspace.size)
            corner = (center - edge / 2)[[across, up]]
            ax.add_patch(
                Rectangle(tuple(corner), edge[across], edge[up], fill=False, color="tab:red")
            )
            ax.set_xlabel(f"{'xyz'[across]} [m]")
            ax.set_ylabel(f"{'xyz'[up]} [m]")
            figure.colorbar(image, ax=ax, label=f"cells along {'xyz'[along]}", shrink=0.8)
        cells = f"{len(workspace.cells)} cells reached"
        figure.suptitle(
            f"Workspace of {robot.name}: {cells}; "
            "the straight arm in black, the Anchor Space in red"
        )
