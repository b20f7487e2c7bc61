"""Disturb the robot in the live view: by noise, lost or late observations, pushes at the tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import rounded, ruler
from cdcsr.simulation.contract import Simulation

Array = NDArray[np.float64]


class ShownNumber(NamedTuple):
    """A number that can be changed while the robot moves."""

    title: str
    low: float
    high: float
    step: float
    start: float = 1.0
    scale: float = 1.0
    """The factor from the number shown to the one that acts."""

    def check(self, value: float) -> None:
        """Check that a value is in range.

        Raises:
            CdcsrError: it is not.
        """
        if not self.low <= value <= self.high:
            raise CdcsrError(f"{self.title}: from {self.low:g} to {self.high:g}; found {value:g}.")

    def grown(self, factor: float) -> ShownNumber:
        """Return the same number with another range and step: those of a robot of another size."""
        low, high, step = (rounded(factor * x) for x in (self.low, self.high, self.step))
        return self._replace(low=low, high=high, step=step)


NOISES: Mapping[str, ShownNumber] = {
    "action_noise": ShownNumber("noise of commands, share of range", 0.0, 0.5, 0.01, 0.0),
    "base_noise": ShownNumber("noise of base position [mm]", 0.0, 200.0, 5.0, 0.0, 1e-3),
    "packet_loss": ShownNumber("observations lost, share", 0.0, 1.0, 0.05, 0.0),
    "observation_delay": ShownNumber("observation delay [actions]", 0.0, 40.0, 1.0, 0.0),
}
"""The fields of :class:`Disturbances` that can be changed, with the paper's robot."""
DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
}
"""The directions of a push in the world."""
_PUSH, _LONG = 2.0, 0.05
"""The largest force at the tip, as a multiple of what a cable's largest pull bears there, and how
long a push of the paper's robot lasts, in [s]."""
_SEED = 0


class Disturbing:
    """Disturb one robot in some simulations, all in the same way.

    Args:
        robot: the description.
        simulations: one copy each.

    Attributes:
        numbers: :data:`NOISES` for this robot.
        noise: their values as they are shown.
        strongest: the largest force of a push, in [N].
        force: the force of the next push, in [N].
    """

    def __init__(self, robot: Robot, simulations: Sequence[Simulation]) -> None:
        self._robot, self._simulations = robot, simulations
        shift = NOISES["base_noise"].grown(ruler(robot).size)
        self.numbers = {**NOISES, "base_noise": shift}
        self.noise = {name: number.start for name, number in self.numbers.items()}
        lever = [s.cables.pitch_radius for s in robot.segments for _ in s.cable_angles]
        pulls = np.array([servo.pull for servo in robot.servos])
        bears = float((pulls * lever).max(initial=0.0)) / robot.arm_length
        self.strongest = rounded(_PUSH * bears) or 1.0
        self._range = float(np.abs(robot.full_commands).max(initial=0.0))
        self.force = self.strongest / 2
        self._long = max(1, round(_LONG * ruler(robot).pace / robot.time_step))
        self._left = 0
        self.channel = self._new_channel()

    @property
    def hold(self) -> int:
        """For how many steps nothing changes from outside; 0 is no limit."""
        return self._left

    def set_noise(self, name: str, value: float) -> None:
        """Change one of :attr:`numbers`, as it is shown.

        Raises:
            CdcsrError: there is no such number, or it is out of range.
        """
        if name not in self.numbers:
            raise CdcsrError(unknown_choice("disturbance", name, self.numbers))
        self.numbers[name].check(value)
        self.noise = self.noise | {name: value}
        self.channel = self._new_channel()

    def push(self, direction: str) -> None:
        """Push the middle of the last link for a moment, with :attr:`force`.

        Raises:
            CdcsrError: there is no such direction.
        """
        if direction not in DIRECTIONS:
            raise CdcsrError(unknown_choice("direction", direction, DIRECTIONS))
        self._set_loads(self.force * np.array(DIRECTIONS[direction]))
        self._left = self._long

    def set_force(self, force: float) -> None:
        """Set the force of the next push, in [N].

        Raises:
            CdcsrError: it is out of range.
        """
        ShownNumber("The force of a push [N]", 0.0, self.strongest, 0.0).check(force)
        self.force = force

    def passed(self, steps: int) -> None:
        """Let a push end when its steps have passed."""
        if self._left:
            self._left = max(0, self._left - steps)
            if not self._left:
                self._set_loads(np.zeros(3))

    def stop(self) -> None:
        """End a push."""
        self.passed(self._left)

    def _set_loads(self, force: Array) -> None:
        for simulation in self._simulations:
            simulation.set_loads(None, -1, force=force)

    def _new_channel(self) -> Channel:
        values = {name: shown * self.numbers[name].scale for name, shown in self.noise.items()}
        values["action_noise"] *= self._range  # in the commands' own unit
        delay = round(values.pop("observation_delay"))
        strength = Disturbances(observation_delay=delay, **values)
        return Channel(strength, np.random.default_rng(_SEED))
