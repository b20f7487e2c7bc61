"""Map a robot's workspace: the points that the scripted demonstrator reaches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import tip_at_start
from cdcsr.robot.ruler import ruler
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.workspace_map import Workspace, cells_between
from controllers.jacobian import JacobianController
from controllers.rollout import rollout

Array = NDArray[np.float64]
Point = tuple[int, int, int]

BATCH = 128
"""The number of targets that are tried side by side."""
_NEIGHBOURS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])


@dataclass
class _Search:
    """The points of a grid that were tried, and those that wait; indices from the middle."""

    reached: list[Point]
    waiting: list[Point]
    missed: list[Point] = field(default_factory=list)
    diverged: int = 0
    """How many episodes diverged."""

    def write(self, path: Path, same: object) -> None:
        """Write everything, and what must be the same for the map to go on."""
        write_json(path, {"same": same, **asdict(self)})

    @classmethod
    def read(cls, path: Path, same: object) -> _Search:
        """Read what :meth:`write` wrote.

        Raises:
            CdcsrError: it is damaged, or of another map.
        """
        try:
            data = read_json(path)
            found = data.pop("same")
            reached, waiting, missed = (
                [(x, y, z) for x, y, z in data[name]] for name in ("reached", "waiting", "missed")
            )
            search = cls(reached, waiting, missed, int(data["diverged"]))
        except (KeyError, TypeError, ValueError) as error:
            raise CdcsrError(f"{path} is damaged ({error!r}); delete it to begin anew.") from None
        if found != same:
            raise CdcsrError(
                f"{path} is of a map with other options, which was interrupted; repeat those "
                "options to finish it, or delete it."
            )
        return search


def compute_workspace(
    robot: Robot,
    backend: str,
    spacing: float,
    frame_skip: int,
    progress: Callable[[int, int, int, int], None] = lambda *_: None,
    record: Path | None = None,
) -> Workspace:
    """Try the points of a grid, from the tip at the start and the middle of the Anchor Space
    outwards.

    Each point that is reached has its neighbours tried too, so points that no path along reached
    points connects to the two stay unknown.

    Args:
        robot: the description.
        backend: the engine.
        spacing: the distance between neighbours in the grid, in [m].
        frame_skip: how many simulation steps each of the demonstrator's commands is held for.
        progress: called after each batch with the numbers of points tried, of points found so far,
            of points reached, and of episodes that diverged.
        record: a file that is written after each batch. If it is there, the map goes on from it, to
            the same bits as without a break.

    Raises:
        CdcsrError: the demonstrator reaches all corners of no cell of the grid, or the record is
            damaged or of another map.
    """
    middle = np.array(robot.workspace.center)
    tip = tip_at_start(robot)
    nearest: Point = tuple(np.rint((tip - middle) / spacing).astype(int).tolist())
    search = _Search([], list(dict.fromkeys([nearest, (0, 0, 0)])))
    task = make_task("reach", robot)
    same = {
        "robot": robot.fingerprint,
        "middle": middle.tolist(),
        "numbers": [spacing, frame_skip, task.threshold, task.max_steps],
        "backend": backend,
    }
    if record is not None and record.exists():
        search = _Search.read(record, same)
    known = {*search.reached, *search.waiting, *search.missed}
    controller = JacobianController(robot)
    while search.waiting:
        batch, search.waiting = search.waiting[:BATCH], search.waiting[BATCH:]
        env = TaskVectorEnv(
            len(batch), robot, backend, frame_skip=frame_skip, autoreset_mode="Disabled"
        )
        try:
            observation, _ = env.reset(options={"targets": middle + spacing * np.array(batch)})
            done = rollout(controller, env, observation)
        finally:
            env.close()
        search.diverged += done.diverged
        for point, success in zip(batch, done.success, strict=True):
            (search.reached if success else search.missed).append(point)
            for x, y, z in (np.array(point) + _NEIGHBOURS * success).tolist():
                if (x, y, z) not in known:
                    known.add((x, y, z))
                    search.waiting.append((x, y, z))
        if record is not None:
            search.write(record, same)
        tried = len(search.reached) + len(search.missed)
        progress(tried, len(known), len(search.reached), search.diverged)
    cells, wide = cells_between(np.array(search.reached, dtype=np.int64).reshape(-1, 3))
    if len(cells) == 0:
        if record is not None:
            record.unlink(missing_ok=True)
        raise CdcsrError(
            f"The demonstrator reaches {len(search.reached)} of {len(known)} points {spacing:g} m "
            f"apart around the tip and the Anchor Space of {robot.name!r}, and no whole cell "
            "between them; take a smaller --spacing or move the robot's workspace."
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
            margin = 0.1 * ruler(robot).size
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
