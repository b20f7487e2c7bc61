"""State of the copies of a robot, their equation of motion, and snapshots.

The first axis of every array is the copy; :mod:`cdcsr.simulation.contract` says the order of
coordinates and what C, J, H and nv are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """The measured state of num copies at one moment, in the world frame."""

    time: Array
    """Shape (num,), in [s]."""
    tip_position: Array
    """Shape (num, 3), in [m]."""
    tip_velocity: Array
    """Shape (num, 3), in [m/s]."""
    base_position: Array
    """Shape (num, 3), in [m]."""
    base_quaternion: Array
    """w-x-y-z, unit length, shape (num, 4)."""
    base_velocity: Array
    """The velocity of the base's centre, shape (num, 3), in [m/s]."""
    base_angular_velocity: Array
    """Shape (num, 3), in [rad/s]."""
    cable_travel: Array
    """Slider positions, shape (num, C), in [m]; negative is pulled."""
    cable_tension: Array
    """The tension in the last step, never negative, shape (num, C), in [N]."""
    joint_angles: Array
    """Angles of the hinges, shape (num, H), in [rad]."""
    joint_rates: Array
    """Rates of the hinges, shape (num, H), in [rad/s]."""


@dataclass(frozen=True)
class Dynamics:
    """The equation of motion of n copies: M qdd + bias = passive + servos - L^T tension.

    A fixed base has the unit matrix in M and zeros everywhere else, which says that it stays.
    """

    mass_matrix: Array
    """M, shape (n, nv, nv)."""
    bias_force: Array
    """Coriolis, centrifugal and gyroscopic forces, less gravity, shape (n, nv)."""
    passive_force: Array
    """Springs and dampers of hinges, friction of sliders, and loads, shape (n, nv)."""
    tip_jacobian: Array
    """Tip velocity = tip_jacobian @ velocity; shape (n, 3, nv)."""
    cable_jacobian: Array
    """L: rate of cable length = cable_jacobian @ velocity; shape (n, C, nv)."""
    velocity: Array
    """Shape (n, nv)."""
    cable_length: Array
    """From slider to anchor, shape (n, C), in [m]."""


@dataclass(frozen=True)
class Snapshot:
    """All that determines the future of every copy, except for robot and parameters.

    Position and velocity are common to all engines, so a snapshot can be carried from one to
    another. `private` holds what else the engine needs to go on to the bit.
    """

    engine: str
    """The engine that made it."""
    robot: str
    """The robot's fingerprint."""
    time: Array
    """Shape (num,), in [s]."""
    position: Array
    """Base position, base quaternion (w-x-y-z), sliders, hinges; shape (num, 7 + C + H)."""
    velocity: Array
    """In the order of coordinates, shape (num, nv)."""
    private: Array
    """Read only by `engine`, shape (num, ...)."""
    commands: Array | None = None
    """The commands of the last K time steps, oldest first, shape (num, K, C), in [m]; K is the
    longest command delay. None means that no commands are under way."""
