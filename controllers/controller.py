"""The contract of a controller: it sees a state and a target, and returns cable commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Dynamics, State
from cdcsr.tasks.starts import StartName

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Target:
    """Where the target of each copy is, in the world frame."""

    position: Array
    """Shape (num, 3), in [m]."""
    velocity: Array
    """Shape (num, 3), in [m/s]; NaN for a controller that is not privileged."""


@dataclass(frozen=True)
class Conditions:
    """The conditions under which a controller acts for a batch of episodes."""

    robot: Robot
    """The robot that is controlled."""
    period: float
    """The time from one action to the next, in [s]."""
    stays: bool
    """True if the tip has to stay at the target, False if it only has to reach it."""
    engine: str | None = None
    """The name of the engine that simulates the robot, if one does."""
    dynamics: Callable[[NDArray[np.int64]], Dynamics] | None = None
    """Returns the present equation of motion of the chosen copies, of the plant as it really is."""


class Controller(ABC):
    """Chooses commands for a batch of robots, with one call for all of them.

    Attributes:
        name: the name in tables.
        privileged: whether it is given the true state of the plant and the target's velocity. If
            not, it is given only what eq. (1) holds, after noise, losses and delays.
        frame_skip: how many simulation steps each of its actions is held for; None for the robot's
            own number.
        task: the task it is made for, a name in :data:`cdcsr.tasks.catalogue.TASKS`.
        space: the operation space it was trained in; None if it was not trained.
        start: how the episodes begin that it is made for: still, moving or anywhere.
        engine: the engine it was trained in; None if it was not trained.
    """

    name: str
    privileged: bool = False
    frame_skip: int | None = None
    task: str = "reach"
    start: StartName = "still"
    space: str | None = None
    engine: str | None = None

    @property
    def centers(self) -> Array | None:
        """The targets of its demonstrations, shape (n, 3), in [m]: Floating and Spatter surround
        them. None stands for those of the paper's ten demonstrations."""
        return None

    def on(self, plant: Robot) -> Controller:
        """Return a controller that also acts on one plant with other numbers: by default itself."""
        return self

    def begin(self, conditions: Conditions) -> None:  # noqa: B027 (a controller may ignore it)
        """Prepare for a batch of episodes; called before the first action of each batch."""

    @abstractmethod
    def act(self, state: State, target: Target, time: Array) -> Array:
        """Return the commands until the next action.

        Args:
            state: arrays of shape (num, ...). If the controller is not privileged, quantities that
                eq. (1) lacks are NaN.
            target: the target of each copy.
            time: since the start of each episode, shape (num,), in [s]. It is NaN for copies whose
                episode is over; their commands are ignored.

        Returns:
            Commands of the servos, shape (num, C), in the robot's `command_range`.
        """
