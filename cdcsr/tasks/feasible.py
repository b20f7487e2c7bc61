"""Fit tasks to a robot: change its numbers, and refuse targets that make no task of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import tip_at_start
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.rotations import at_start
from cdcsr.tasks.catalogue import TASKS, make_task
from cdcsr.tasks.spaces import BALLS, Space
from cdcsr.tasks.task import Task

Array = NDArray[np.float64]

_DRAWN, _MOST = 2_000, 0.01


def adjusted(
    robot: Robot,
    task: str,
    spaces: Sequence[str],
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
) -> Robot:
    """Return the same robot with other numbers for a task.

    Args:
        robot: the description.
        task: a name in :data:`cdcsr.tasks.catalogue.TASKS`.
        spaces: where targets lie.
        threshold: the tip is on the target within this distance, in [m]; None for the robot's own.
        seconds: an episode may take so long, in [s]; None for the robot's own.
        radius: of the balls of Floating or Spatter, in [m]; None for the robot's own.

    Raises:
        CdcsrError: there is no such task, a number is not positive and finite, or a radius is given
            and `spaces` is not one of Floating and Spatter.
    """
    make_task(task)
    numbers = {"threshold": threshold, "seconds": seconds, "radius": radius}
    for name, value in numbers.items():
        if value is not None and not 0 < value < math.inf:
            raise CdcsrError(f"{name} must be positive and finite, not {value:g}.")
    update: dict[str, float] = {}
    if threshold is not None:
        update["threshold"] = threshold * (Task.threshold / TASKS[task].threshold)
    if seconds is not None:
        update["seconds"] = seconds * (Task.max_steps / TASKS[task].max_steps)
        update["frame_skip"] = ruler(robot).frame_skip  # actions stay as long as they are
    if radius is not None:
        if len(spaces) != 1 or spaces[0] not in BALLS:
            raise CdcsrError(
                f"radius is that of the balls of one space, {' or '.join(BALLS)}; choose one of "
                f"them with --space (found {', '.join(spaces)})."
            )
        update[spaces[0]] = radius
    if not update:
        return robot
    return robot.model_copy(update={"scale": robot.scale.model_copy(update=update)})


def check_targets(robot: Robot, task: Task, space: Space, bent: bool = False) -> None:
    """Check that targets are neither reached before anything is done nor out of reach.

    Args:
        robot: the description.
        task: with the robot's own numbers.
        space: where its targets lie.
        bent: whether episodes begin with a bent arm. Then only the reach is checked.

    Raises:
        CdcsrError: more than 1 % of the targets are reached at once, or more than 1 % are out of
            reach.
    """
    targets = space.sample(np.random.default_rng(0), _DRAWN)
    joint, tip = at_start(robot, [0.0, 0.0, robot.first_joint]), tip_at_start(robot)
    solved = float((np.linalg.norm(targets - tip, axis=1) <= task.threshold).mean())
    if solved > _MOST and not bent:
        raise CdcsrError(
            f"{solved:.1%} of the targets in the space {space.name!r} lie within the threshold of "
            f"{task.threshold:g} m of the tip at the start, at {_place(tip)}: the task "
            f"{task.name!r} is solved there before anything is done. Move the workspace of "
            f"{robot.name!r} away from the tip, or take a smaller threshold or radius."
        )
    reach = robot.top + robot.arm_length - robot.first_joint
    far = float((np.linalg.norm(targets - joint, axis=1) > reach + task.threshold).mean())
    if far > _MOST:
        raise CdcsrError(
            f"{far:.1%} of the targets in the space {space.name!r} are out of reach: they lie more "
            f"than the {reach:g} m that the arm of {robot.name!r} is long, and the threshold of "
            f"{task.threshold:g} m, from its first joint, at {_place(joint)}. At most "
            f"{_MOST:.0%} may be: move or shrink the robot's workspace, or take a smaller radius."
        )


def _place(point: Array) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)}) m"
