"""The keyword arguments of the environments, and the options of their resets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.simulation.arguments import as_floats
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.starts import Starts
from cdcsr.tasks.target_motion import MotionName
from cdcsr.tasks.task import Reward, Task

Array = NDArray[np.float64]


class TaskOptions(TypedDict, total=False):
    """The keyword arguments that change a task."""

    reward: Reward | None
    """The reward, "sparse" (eq. 2) or "dense"; by default the task's."""
    max_steps: int | None
    """An episode is truncated after this many simulation steps; by default the task's."""
    threshold: float | None
    """The tip is on the target within this distance, in [m]; by default the task's."""
    motion: MotionName | None
    """How targets move; by default the task's."""
    quiet: bool | None
    """Success counts only while the base is near its start; by default the task's."""


class EnvOptions(TaskOptions, total=False):
    """The keyword arguments that :class:`TaskEnv` and :class:`TaskVectorEnv` share."""

    robot: Robot | str
    """A robot, the path of a description, or the name of a shipped one; by default "paper"."""
    backend: str
    """The engine; by default "mujoco"."""
    space: str
    """The operation space in which targets are drawn; by default "anchor"."""
    frame_skip: int | None
    """How many simulation steps each action is held for; by default the robot's own number, 1 for
    that of the paper."""
    centers: Array | None
    """The targets of the demonstrations, shape (n, 3), in [m]; Floating and Spatter surround
    them. By default those of the paper's ten."""
    disturbances: Disturbances | None
    """They act between policy and robot; by default there are none."""
    randomization: Randomization | None
    """Draws a new plant for every episode; by default all plants are as described."""
    start: str | Starts
    """The states in which episodes begin: "still" (the default), "moving" or "anywhere"; see
    :mod:`cdcsr.tasks.starts`."""
    task: str | Task
    """A task, or a name in :data:`cdcsr.tasks.catalogue.TASKS`; by default "reach"."""


def read_reset_options(
    options: Mapping[str, object] | None, **shapes: tuple[int, ...]
) -> dict[str, Array]:
    """Return the options of a reset as arrays.

    Args:
        options: what the user gave.
        shapes: the shape of each option that there is.

    Raises:
        CdcsrError: an option is unknown, has the wrong shape or is not finite.
    """
    arrays: dict[str, Array] = {}
    for name, value in (options or {}).items():
        if name not in shapes:
            raise CdcsrError(unknown_choice("reset option", name, shapes))
        arrays[name] = as_floats(
            f"The reset option {name!r}", value, shapes[name], kinds="b" * (name == "reset_mask")
        )
    if not np.isin(arrays.get("reset_mask", 1), (0, 1)).all():
        raise CdcsrError("The reset option 'reset_mask' holds only True and False, or 1 and 0.")
    return arrays
