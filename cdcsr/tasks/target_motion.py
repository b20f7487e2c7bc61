"""How targets move. A policy observes the position of its target, not its velocity.

A motion draws everything random when an episode begins, so that steps draw nothing. What it has to
remember of each copy is one row of numbers, its memory, which can be saved and restored. Steps take
arrays of any library, see :mod:`cdcsr.tasks.task`; only NumPy's are drawn.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from typing import ClassVar, Literal, Self, get_args

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice

Array = NDArray[np.float64]
Units = dict[str, tuple[int, int]]
"""The powers of metres and seconds in the unit of each number."""
MotionName = Literal["rest", "drift", "tumble", "line", "circle", "random"]


class Motion(ABC):
    """Move the targets of many copies."""

    size: int = 0
    """How many numbers the memory of a copy has."""
    units: ClassVar[Units] = {}
    """The units of the numbers of a motion."""

    def scaled(self, size: float, pace: float) -> Self:
        """Return the same motion with all lengths times `size` and all times times `pace`."""
        twin = copy(self)
        for name, (metres, seconds) in self.units.items():
            factor = size**metres * pace**seconds
            setattr(twin, name, np.multiply(getattr(self, name), factor))
        return twin

    @abstractmethod
    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        """Draw how targets move that start at a position.

        Args:
            rng: draws everything that is random.
            position: shape (n, 3), in [m].

        Returns:
            Velocity, shape (n, 3), in [m/s], and memory, shape (n, size).
        """

    @abstractmethod
    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        """Move the targets on, in place.

        Args:
            position: shape (num, 3), in [m].
            velocity: shape (num, 3), in [m/s].
            memory: shape (num, size).
            period: the time that passes, in [s].
        """


class Rest(Motion):
    """Keep the target where it is."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        return np.zeros_like(position), np.zeros((len(position), self.size))

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        pass


class Drift(Motion):
    """Move at a constant velocity in any direction, as debris that floats by."""

    units: ClassVar[Units] = {"speed": (1, -1)}
    speed = 0.1
    """The largest speed, in [m/s]; speeds are uniform from zero."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        return directions(rng, num) * rng.uniform(0, self.speed, (num, 1)), np.zeros(
            (num, self.size)
        )

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        position += velocity * period


class Line(Drift):
    """Move straight down at a constant speed, as in Fig. 6 of the BATD3 paper."""

    units: ClassVar[Units] = {"slowest": (1, -1), "speed": (1, -1)}
    slowest, speed = 0.05, 0.1
    """The least and the largest speed, in [m/s]; speeds are uniform between them."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        return rng.uniform(self.slowest, self.speed, (num, 1)) * [0.0, 0.0, -1.0], np.zeros(
            (num, self.size)
        )


class Turning(Motion):
    """Move as a point of a rigid body that turns at a constant rate about a centre at rest.

    The memory holds the centre in [m] and the angular velocity in [rad/s].
    """

    size = 6

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        center, spin = memory[:, :3], memory[:, 3:6]
        position[:] = center + _turned(position - center, spin * period)
        velocity[:] = array_namespace(spin).linalg.cross(spin, position - center)

    def _start(self, position: Array, center: Array, spin: Array) -> tuple[Array, Array]:
        return np.cross(spin, position - center), np.concatenate([center, spin], axis=1)


class Tumble(Turning):
    """Move as a point on tumbling debris. The axis may have any direction, so the speed is at most
    radius times rate."""

    units: ClassVar[Units] = {"radius": (1, 0), "rate": (0, -1)}
    radius = (0.03, 0.1)
    """The least and the largest distance from the debris's centre, in [m]; uniform."""
    rate = (0.2, 1.0)
    """The least and the largest angular speed, in [rad/s]; uniform."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        center = position - directions(rng, num) * rng.uniform(*self.radius, (num, 1))
        return self._start(
            position, center, directions(rng, num) * rng.uniform(*self.rate, (num, 1))
        )


class Circle(Turning):
    """Move on a horizontal circle to the left or the right, starting anywhere on it."""

    units: ClassVar[Units] = {"radius": (1, 0), "rate": (0, -1)}
    radius = (0.03, 0.06)
    """The least and the largest radius, in [m]; uniform."""
    rate = 2.5
    """In [rad/s]: once around in 2.5 s, the length of a Follow episode."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        angle, radius = rng.uniform(0, 2 * np.pi, num), rng.uniform(*self.radius, num)
        offset = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(num)], axis=1)
        spin = rng.choice([-self.rate, self.rate], (num, 1)) * [0.0, 0.0, 1.0]
        return self._start(position, position - offset, spin)


class Wander(Motion):
    """Move under a random acceleration that changes from time to time, and a weak damped spring
    that keeps the target near its start.

    The memory holds the start in [m], the time in [s] and the accelerations in [m/s²] in order.
    After the last one the first follows; a Follow episode of the usual length ends before that.
    """

    units: ClassVar[Units] = {
        **{"hold": (0, 1), "acceleration": (1, -2)},
        **{"spring": (0, -2), "damper": (0, -1)},
    }
    hold = 0.25
    """How long each acceleration lasts, in [s]."""
    acceleration = 0.4
    """The largest acceleration, in [m/s²]; uniform from zero."""
    spring, damper = 2.0, 1.0
    """The spring's stiffness in [1/s²] and its damping in [1/s], per unit of mass."""
    draws = 16
    size = 4 + 3 * draws

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        size = rng.uniform(0, self.acceleration, (num, self.draws, 1))
        drawn = directions(rng, num * self.draws).reshape(num, self.draws, 3) * size
        return np.zeros((num, 3)), np.concatenate(
            [position, np.zeros((num, 1)), drawn.reshape(num, -1)], axis=1
        )

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        # The small addition keeps 99.999... holds from counting as 99.
        xp = array_namespace(memory)
        index = xp.astype(memory[:, 3] / self.hold + 1e-6, xp.int64) % self.draws
        copies = xp.arange(len(index), device=memory.device)
        drawn = memory[:, 4:].reshape(-1, self.draws, 3)[copies, index]
        total = drawn - self.spring * (position - memory[:, :3]) - self.damper * velocity
        position += velocity * period + total * (period**2 / 2)
        velocity += total * period
        memory[:, 3] += period


MOTIONS: dict[str, Motion] = {
    "rest": Rest(),
    "drift": Drift(),
    "tumble": Tumble(),
    "line": Line(),
    "circle": Circle(),
    "random": Wander(),
}


def make_motion(name: str, size: float = 1.0, pace: float = 1.0) -> Motion:
    """Return a motion by its name in :data:`MOTIONS`.

    Args:
        name: which motion.
        size: all its lengths are multiplied by it.
        pace: all its times are multiplied by it.

    Raises:
        CdcsrError: there is no such motion.
    """
    if name not in MOTIONS:
        raise CdcsrError(unknown_choice("motion", name, get_args(MotionName)))
    return MOTIONS[name].scaled(size, pace)


def directions(rng: np.random.Generator, num: int) -> Array:
    """Draw unit vectors, shape (num, 3), whose directions are uniform on the sphere."""
    direction = rng.normal(size=(num, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _turned(vector: Array, rotation: Array) -> Array:
    """Turn vectors about `rotation` by its length in [rad] (Rodrigues' formula); shapes (n, 3)."""
    xp = array_namespace(vector)
    angle = xp.linalg.vector_norm(rotation, axis=1, keepdims=True)
    axis = rotation / (angle + (angle == 0))
    along = xp.sum(axis * vector, axis=1, keepdims=True) * axis
    across = xp.linalg.cross(axis, vector)
    return along + xp.cos(angle) * (vector - along) + xp.sin(angle) * across
