"""The contract every engine meets: `num` independent copies of one robot, stepped together.

The first axis of every array is the copy. Coordinates, wherever a full vector appears, are in one order:
base linear, base angular (both world frame), sliders, hinges root to tip (x before y at each joint).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot
from cdcsr.simulation.delay_line import DelayLine
from cdcsr.simulation.plant import Parameters, Plant

Array = NDArray[np.float64]
Ids = Sequence[int] | NDArray[np.integer] | None
"""Which copies: sorted unique indices, or None for all."""

Capability = Literal["render", "bit_exact", "own_settings"]
"""render: has its own camera. bit_exact: the same commands give the same bits, also after a snapshot. own_settings:
has `use_own_settings`."""


@dataclass(frozen=True)
class State:
    """What can be measured, at one moment. World frame, shapes (num, ...)."""

    time: Array
    """(num,) [s]."""
    tip_position: Array
    """(num, 3) [m]."""
    tip_velocity: Array
    """(num, 3) [m/s]."""
    base_position: Array
    """(num, 3) [m]."""
    base_quaternion: Array
    """(num, 4), w-x-y-z, unit length."""
    base_velocity: Array
    """(num, 3) [m/s], of the base's centre."""
    base_angular_velocity: Array
    """(num, 3) [rad/s]."""
    cable_travel: Array
    """(num, C) slider positions [m]; negative is pulled."""
    cable_tension: Array
    """(num, C) [N], never negative; of the step just made."""
    joint_angles: Array
    """(num, 2 J) [rad]."""
    joint_rates: Array
    """(num, 2 J) [rad/s]."""


@dataclass(frozen=True)
class Dynamics:
    """The equation of motion M qdd + bias = passive + servos - L^T tensions, at one moment."""

    mass_matrix: Array
    """(n, nv, nv)."""
    bias_force: Array
    """(n, nv) Coriolis, centrifugal and gyroscopic forces."""
    passive_force: Array
    """(n, nv) springs and dampers of hinges, friction of sliders."""
    tip_jacobian: Array
    """(n, 3, nv) tip velocity = tip_jacobian @ velocity."""
    cable_jacobian: Array
    """(n, C, nv) rate of cable length."""
    velocity: Array
    """(n, nv)."""
    cable_length: Array
    """(n, C) [m], from slider to anchor."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that determines the future of every copy, but for the robot and the parameters it was made with.

    Position and velocity are common to all engines, so a snapshot can be carried from one to another;
    `private` is what else the engine that made it needs to continue as if it had never stopped.
    """

    engine: str
    robot: str
    """The robot's fingerprint."""
    time: Array
    """(num,) [s]."""
    position: Array
    """(num, 7 + C + 2 J): base position, base quaternion (w-x-y-z), sliders, hinges."""
    velocity: Array
    """(num, 6 + C + 2 J), in the order of coordinates."""
    private: Array
    """(num, ...) read only by `engine`."""
    commands: Array | None = None
    """(num, K, C) those of the last K time steps, oldest first, in [m]; K is the longest command delay. None is
    no commands under way."""


class Simulation(ABC):
    """`num` copies of a robot in one engine, all at rest and straight at the start.

    Args:
        robot: the description.
        num: how many copies.

    Commands are servo set-points, shape (num, C), in [-eta, 0] m; engines do not clip them.

    Attributes:
        plant: the numbers of every copy that `set_parameters` changes, to be read only.
    """

    engine: ClassVar[str]
    """The name that chooses the engine, as in `--backend`."""
    title: ClassVar[str]
    """The engine's name as it is written in text."""
    capabilities: ClassVar[frozenset[Capability]]

    def __init__(self, robot: Robot, num: int = 1) -> None:
        if num < 1:
            raise CdcsrError(f"A simulation needs at least one copy, not {num}.")
        self.robot = robot
        self.num = num
        self.plant: Plant = Parameters().plant(robot, num)
        self._line = DelayLine(num, robot.num_cables)

    def set_parameters(self, ids: Ids, parameters: Parameters) -> None:
        """Make copies differ from the description, in everything that `parameters` hold; until set again.

        They act from the next step on, and neither reset nor a snapshot changes them. Commands sent before there
        was any delay count as zero where a delay now asks for them.

        Args:
            ids: which copies.
            parameters: arrays in them have as many rows as there are `ids`.

        Raises:
            CdcsrError: a parameter has a shape that does not fit, or lies outside its range.
        """
        chosen = self._chosen(ids)
        plant, delay = parameters.plant(self.robot, len(chosen)), parameters.delay(len(chosen))
        for mine, new in zip(self.plant, plant, strict=True):
            mine[chosen] = new
        self._line.set_delay(chosen, delay)
        self._set_plant(chosen, plant)

    def use_own_settings(self, numbers: bool = True) -> None:
        """From now on step as the engine does by itself, and put all copies back to the start.

        What an engine was told only so that it agrees with the description and the other engines is undone; masses,
        routes, springs, dampers and servos stay. Each engine says in its own docstring what that comes to.

        Args:
            numbers: with the engine's own numbers, too; otherwise it holds cables in its own way, if it has one, with
                the softness that the description gives.

        Raises:
            CdcsrError: the engine lacks the capability "own_settings".
        """
        raise CdcsrError(
            f"The engine {self.engine!r} declares no settings of its own to go back to."
        )

    def reset(self, ids: Ids = None) -> None:
        """Put copies back to the start: straight, at rest, time zero. The others are untouched.

        Parameters stay as they were set. A slider whose cable they have shortened begins where that is just taut.
        """
        chosen = self._chosen(ids)
        self._stop_commands(chosen)
        self._reset(chosen)

    def step(self, command: Array, substeps: int = 1) -> None:
        """Advance all copies by `substeps` time steps under one command.

        Raises:
            CdcsrError: the command has another shape than (num, C), or a number in it is not finite.
            Diverged: a copy's numbers left the range in which they mean anything.
        """
        command = np.ascontiguousarray(command, dtype=float)
        expected = self.plant.servo_gain.shape
        if command.shape != expected:
            raise CdcsrError(
                f"Commands have the shape (num, cables) = {expected}, not {command.shape}."
            )
        if not np.isfinite(command).all():  # an engine may take it for no command at all
            copy = int(np.flatnonzero(~np.isfinite(command).all(axis=1))[0])
            raise CdcsrError(
                f"Commands must be finite; that of copy {copy} is {command[copy].tolist()}."
            )
        if self._line.idle:
            self._step(command, substeps)
            return
        lost: Diverged | None = None
        for _ in range(substeps):
            try:
                self._step(self._line.push(command), 1)
            except Diverged as error:  # the other copies are still owed all substeps
                lost = lost or error
        if lost is not None:
            raise lost

    @abstractmethod
    def state(self) -> State:
        """The state of all copies. The arrays stay as they are when the simulation goes on."""

    def get_snapshot(self) -> Snapshot:
        """Everything that determines the future of all copies, but for robot and parameters."""
        snapshot = self._get_snapshot()
        return snapshot if self._line.idle else replace(snapshot, commands=self._line.sent)

    def set_snapshot(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of the same robot, from this engine or another; parameters stay as they are.

        Raises:
            CdcsrError: it is of another robot or another number of copies.
        """
        if snapshot.robot != self.robot.fingerprint:
            raise CdcsrError(
                f"The snapshot is of robot {snapshot.robot}; this simulation runs {self.robot.fingerprint}."
            )
        if len(snapshot.time) != self.num:
            raise CdcsrError(
                f"The snapshot holds {len(snapshot.time)} copies; this simulation has {self.num}."
            )
        none = np.zeros((self.num, 0, self.robot.num_cables))
        self._line.sent = none if snapshot.commands is None else snapshot.commands
        self._set_snapshot(snapshot)

    @abstractmethod
    def dynamics(self, ids: Ids = None) -> Dynamics:
        """The equation of motion of some copies, from this engine's own model."""

    def step_dynamics(self, ids: Ids = None) -> Dynamics | None:
        """The equation of motion as `step` evaluates it, or None if that is the same code as `dynamics`.

        An engine that steps with an evaluation of its own must show it here, so that parity is measured on it too.
        """
        return None

    @abstractmethod
    def render(self, index: int = 0, camera: str = "side") -> NDArray[np.uint8]:
        """A picture of one copy, shape (height, width, 3).

        Raises:
            CdcsrError: there is nothing to draw with.
        """

    @abstractmethod
    def close(self) -> None:
        """Release what the engine holds."""

    # What an engine does of the above. The checks are done, commands already delayed, and copies in order.

    @abstractmethod
    def _set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give copies `ids` the numbers in the rows of `plant`, from the next step on and in `dynamics`."""

    @abstractmethod
    def _reset(self, ids: NDArray[np.int64]) -> None: ...

    @abstractmethod
    def _step(self, command: Array, substeps: int) -> None: ...

    @abstractmethod
    def _get_snapshot(self) -> Snapshot: ...

    @abstractmethod
    def _set_snapshot(self, snapshot: Snapshot) -> None: ...

    def _stop_commands(self, ids: NDArray[np.int64]) -> None:
        """Forget what is under way to copies that are back at the start, where all set-points are zero."""
        self._line.fill(ids, np.zeros((len(ids), self.robot.num_cables)))

    def _chosen(self, ids: Ids) -> NDArray[np.int64]:
        every = np.arange(self.num)
        return every if ids is None else every[np.asarray(ids, dtype=np.int64)]


CAMERAS: dict[str, tuple[float, float]] = {
    "side": (55.0, -8.0),
    "front": (0.0, 0.0),
    "top": (55.0, -50.0),
}
"""Named views: azimuth around z from the y axis, and elevation, in degrees; all look at the middle of the robot."""
