"""Who chooses the commands in the live view: the user's hand, a controller, or a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Channel
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Simulation

Array = NDArray[np.float64]

HAND, RECORDING = "by hand", "recording"
"""The names of what drives the robot if no controller does."""


class Driver(Protocol):
    """Chooses commands from the state of one simulation and a target that may be moved."""

    @property
    def name(self) -> str: ...

    @property
    def frame_skip(self) -> int: ...

    def begin(self, simulation: Simulation) -> None:
        """Prepare for an episode of a simulation that begins now."""

    def act(self, target: Array, time: float, channel: Channel | None = None) -> Array:
        """Return the commands until the next action.

        Args:
            target: shape (3,), world frame, in [m].
            time: since the episode began, in [s].
            channel: what its observations pass through, if they are disturbed.

        Returns:
            Set-points, shape (C,), in [m].
        """
        ...


class Shown(NamedTuple):
    """An episode that was recorded or measured before."""

    target: Array
    """Where the target was at the start, shape (3,), in [m]."""
    success: bool
    commands: Array | None = None
    """The set-points that were sent, shape (T, C), in [m]."""
    hold: int = 1
    """The number of simulation steps for which each command was held."""


class Driving:
    """Choose the command of one robot, step by step.

    Args:
        robot: the description.
        drivers: controllers, with names that differ.
        episodes: episodes that can be shown again.

    Attributes:
        name: who drives now, one of `names`.
        command: the present set-points, shape (C,), in [m].
        arriving: what arrives of them at the servos, shape (C,), in [m].
        chosen: the episode that is shown, counted from 0.
    """

    def __init__(self, robot: Robot, drivers: Sequence[Driver], episodes: Sequence[Shown]) -> None:
        self.drivers = {driver.name: driver for driver in drivers}
        self.episodes, self.chosen, self.name = list(episodes), 0, HAND
        self.full = robot.full_commands
        self.lowest, self.highest = robot.command_range
        self.units = [servo.unit for servo in robot.servos]
        self.command, self._period = np.zeros(robot.num_cables), robot.time_step
        self.arriving = self._noise = self.command
        self._skip = ruler(robot).frame_skip
        self._begun = 0

    @property
    def names(self) -> list[str]:
        """The names of all that can drive the robot."""
        recorded = any(episode.commands is not None for episode in self.episodes)
        return [HAND, *self.drivers, *([RECORDING] if recorded else [])]

    def pull(self, cable: int, set_point: float) -> None:
        """Set the command of one cable, in [m] or [N]; from then on the user's hand drives.

        Raises:
            CdcsrError: there is no such cable, or the set-point is out of its range.
        """
        if not 0 <= cable < len(self.full):
            raise CdcsrError(f"There is no cable {cable + 1}; there are {len(self.full)}.")
        if not self.lowest[cable] - 1e-9 <= set_point <= self.highest[cable] + 1e-9:
            raise CdcsrError(
                f"The set-point of cable {cable + 1} lies from {self.full[cable]:g} "
                f"{self.units[cable]} to 0; found {set_point:g} {self.units[cable]}."
            )
        self.name, self.command = HAND, self.command.copy()
        self.command[cable] = set_point

    def choose(self, name: str) -> None:
        """Choose who drives from the next `begin` on.

        Raises:
            CdcsrError: nobody of that name can drive.
        """
        if name not in self.names:
            raise CdcsrError(unknown_choice("driver", name, self.names))
        self.name = name

    def show(self, number: int) -> Array:
        """Choose an episode, counted from 0, and return its target, shape (3,), in [m].

        Its recording drives if it has one; else a controller does if there is one.

        Raises:
            CdcsrError: there is no such episode.
        """
        if not 0 <= number < len(self.episodes):
            raise CdcsrError(f"There is no episode {number + 1}; there are {len(self.episodes)}.")
        self.chosen, episode = number, self.episodes[number]
        if episode.commands is not None:
            self.name = RECORDING
        elif self.name == HAND and self.drivers:
            self.name = next(iter(self.drivers))
        return episode.target

    def next_failure(self) -> int:
        """Return the number of the next episode that failed.

        Raises:
            CdcsrError: none failed.
        """
        failed = [n for n, episode in enumerate(self.episodes) if not episode.success]
        if not failed:
            raise CdcsrError(f"None of the {len(self.episodes)} episodes failed.")
        return next((n for n in failed if n > self.chosen), failed[0])

    def begin(self, simulation: Simulation, step: int) -> None:
        """Begin an episode of whoever drives, at a number of steps since the last reset.

        Raises:
            CdcsrError: the controller cannot drive this robot.
        """
        self._begun = step
        if self.name in self.drivers:
            self.drivers[self.name].begin(simulation)

    def next_command(self, step: int, target: Array, channel: Channel) -> int:
        """Choose the command of a step, and return for how many steps it holds (0: no limit).

        Args:
            step: how many steps were made since the last reset.
            target: shape (3,), in [m].
            channel: what observations and commands pass through.
        """
        since, episode = step - self._begun, None
        driver = self.drivers.get(self.name)
        if self.name == RECORDING:
            episode = self.episodes[self.chosen]
        recorded = None if episode is None else episode.commands
        if episode is not None and recorded is not None:
            period = episode.hold
            index = min(since // period, len(recorded) - 1)
            self.command = np.clip(recorded[index], self.lowest, self.highest)
        elif driver is not None:
            period = driver.frame_skip
            if since % period == 0:
                command = driver.act(target, since * self._period, channel)
                self.command = np.clip(command, self.lowest, self.highest)
        else:
            period, since = self._skip, 0
        if since % period == 0:
            self._noise = channel.command(np.zeros((1, len(self.full))))[0]
        self.arriving = np.clip(self.command + self._noise, self.lowest, self.highest)
        free = driver is None and recorded is None and not self._noise.any()
        return 0 if free else period - since % period
