"""The contract every engine meets: `num` independent copies of one robot, stepped together.

The first axis of every array is the copy. Coordinates, wherever a full vector appears, are in one order:
base linear, base angular (both world frame), sliders, hinges root to tip (x before y at each joint).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot import Robot

Array = NDArray[np.float64]
Ids = Sequence[int] | NDArray[np.integer] | None
"""Which copies: sorted unique indices, or None for all."""

Capability = Literal["render", "bit_exact"]
"""render: has its own camera. bit_exact: the same commands give the same bits, also after a snapshot."""


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
    """Everything that determines the future of every copy.

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


class Simulation(ABC):
    """`num` copies of a robot in one engine, all at rest and straight at the start.

    Args:
        robot: the description.
        num: how many copies.

    Commands are servo set-points, shape (num, C), in [-eta, 0] m; engines do not clip them.
    """

    engine: ClassVar[str]
    capabilities: ClassVar[frozenset[Capability]]

    def __init__(self, robot: Robot, num: int = 1) -> None:
        if num < 1:
            raise CdcsrError(f"A simulation needs at least one copy, not {num}.")
        self.robot = robot
        self.num = num

    @abstractmethod
    def reset(self, ids: Ids = None) -> None:
        """Put copies back to the start: straight, at rest, time zero. The others are untouched."""

    @abstractmethod
    def step(self, command: Array, substeps: int = 1) -> None:
        """Advance all copies by `substeps` time steps under one command.

        Raises:
            Diverged: a copy's numbers left the range in which they mean anything.
        """

    @abstractmethod
    def state(self) -> State:
        """The state of all copies. The arrays stay as they are when the simulation goes on."""

    @abstractmethod
    def get_snapshot(self) -> Snapshot:
        """Everything that determines the future of all copies."""

    @abstractmethod
    def set_snapshot(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of the same robot, from this engine or another.

        Raises:
            CdcsrError: it is of another robot or another number of copies.
        """

    @abstractmethod
    def dynamics(self, ids: Ids = None) -> Dynamics:
        """The equation of motion of some copies, from this engine's own model."""

    def step_dynamics(self, ids: Ids = None) -> Dynamics | None:  # noqa: ARG002
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

    def _check_snapshot(self, snapshot: Snapshot) -> None:
        if snapshot.robot != self.robot.fingerprint:
            raise CdcsrError(
                f"The snapshot is of robot {snapshot.robot}; this simulation runs {self.robot.fingerprint}."
            )
        if len(snapshot.time) != self.num:
            raise CdcsrError(f"The snapshot holds {len(snapshot.time)} copies; this simulation has {self.num}.")


CAMERAS: dict[str, tuple[float, float]] = {"side": (55.0, -8.0), "front": (0.0, 0.0), "top": (55.0, -50.0)}
"""Named views: azimuth around z from the y axis, and elevation, in degrees; all look at the middle of the robot."""

_GROUP = "cdcsr.backends"


def backend_names() -> list[str]:
    """Names of the installed engines."""
    return sorted({point.name for point in entry_points(group=_GROUP)})


def load_backend(name: str) -> type[Simulation]:
    """The Simulation class of an engine.

    Raises:
        CdcsrError: no engine of that name is installed.
    """
    for point in entry_points(group=_GROUP):
        if point.name == name:
            return point.load()
    raise CdcsrError(unknown_choice("backend", name, backend_names()))


def make_simulation(robot: Robot, backend: str, num: int = 1) -> Simulation:
    """A simulation of `num` copies in the engine of that name."""
    return load_backend(backend)(robot, num)


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrices, shape (..., 3, 3), of unit quaternions w-x-y-z, shape (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
