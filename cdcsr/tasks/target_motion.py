"""How targets move. A policy sees only where its target is; how it moves is the environment's secret.

A motion draws all that is random about an episode when the episode begins, so stepping draws nothing, and what it
remembers of each copy is one row of numbers that can be saved and put back.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice

Array = NDArray[np.float64]
MotionName = Literal["rest", "drift", "tumble", "line", "circle", "random"]


class Motion(ABC):
    """Moves the targets of many copies."""

    size: int = 0
    """Numbers to remember for each copy, besides the target's position and velocity."""

    @abstractmethod
    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        """Start from `position`, shape (n, 3), in [m]: velocity, (n, 3) in [m/s], and memory, (n, size)."""

    @abstractmethod
    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        """Carry position and velocity, shape (num, 3), and memory, (num, size), on by `period` seconds, in place."""


class Rest(Motion):
    """The target stays where it is."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        return np.zeros_like(position), np.zeros((len(position), self.size))

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        pass


class Drift(Motion):
    """A constant velocity in any direction: debris that floats by."""

    speed = 0.1
    """Largest, in [m/s]; uniform from zero."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        return _directions(rng, num) * rng.uniform(0, self.speed, (num, 1)), np.zeros(
            (num, self.size)
        )

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        position += velocity * period


class Line(Drift):
    """Straight down at a constant speed, as in Fig. 6 of the BATD3 paper."""

    slowest, speed = 0.05, 0.1
    """[m/s], uniform between them."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        return rng.uniform(self.slowest, self.speed, (num, 1)) * [0.0, 0.0, -1.0], np.zeros(
            (num, self.size)
        )


class Turning(Motion):
    """A point of a rigid body that turns at a constant rate about a centre at rest.

    Memory: centre in [m], angular velocity in [rad/s].
    """

    size = 6

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        center, spin = memory[:, :3], memory[:, 3:6]
        position[:] = center + _turned(position - center, spin * period)
        velocity[:] = np.cross(spin, position - center)

    def _start(self, position: Array, center: Array, spin: Array) -> tuple[Array, Array]:
        return np.cross(spin, position - center), np.concatenate([center, spin], axis=1)


class Tumble(Turning):
    """A point on tumbling debris: the axis may have any direction, so the speed is at most radius times rate."""

    radius = (0.03, 0.1)
    """From the debris's centre to the target, uniform, in [m]."""
    rate = (0.2, 1.0)
    """Uniform, in [rad/s]."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        center = position - _directions(rng, num) * rng.uniform(*self.radius, (num, 1))
        return self._start(
            position, center, _directions(rng, num) * rng.uniform(*self.rate, (num, 1))
        )


class Circle(Turning):
    """A circle across the straight arm, left or right, begun anywhere on it."""

    radius = (0.03, 0.06)
    """Uniform, in [m]."""
    rate = 2.5
    """[rad/s]: once around in 2.5 s, the length of a Follow episode."""

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        angle, radius = rng.uniform(0, 2 * np.pi, num), rng.uniform(*self.radius, num)
        offset = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(num)], axis=1)
        spin = rng.choice([-self.rate, self.rate], (num, 1)) * [0.0, 0.0, 1.0]
        return self._start(position, position - offset, spin)


class Wander(Motion):
    """A random acceleration, constant for a while, and a weak damped spring that keeps the target near its start.

    Memory: start in [m], time in [s], then the accelerations in [m/s²], one after the other. They begin anew after
    the last, which in a Follow episode of the usual length is not reached.
    """

    hold = 0.25
    """How long an acceleration lasts, in [s]."""
    acceleration = 0.4
    """Largest, in [m/s²]; uniform from zero."""
    spring, damper = 2.0, 1.0
    """In [1/s²] and [1/s]."""
    draws = 16
    size = 4 + 3 * draws

    def begin(self, rng: np.random.Generator, position: Array) -> tuple[Array, Array]:
        num = len(position)
        size = rng.uniform(0, self.acceleration, (num, self.draws, 1))
        drawn = _directions(rng, num * self.draws).reshape(num, self.draws, 3) * size
        return np.zeros((num, 3)), np.concatenate(
            [position, np.zeros((num, 1)), drawn.reshape(num, -1)], axis=1
        )

    def advance(self, position: Array, velocity: Array, memory: Array, period: float) -> None:
        # The small addition keeps 99.999... holds from counting as 99.
        index = (memory[:, 3] / self.hold + 1e-6).astype(np.int64) % self.draws
        drawn = memory[:, 4:].reshape(-1, self.draws, 3)[np.arange(len(index)), index]
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


def make_motion(name: str) -> Motion:
    """The motion of that name.

    Raises:
        CdcsrError: there is no such motion.
    """
    if name not in MOTIONS:
        raise CdcsrError(unknown_choice("motion", name, get_args(MotionName)))
    return MOTIONS[name]


def _directions(rng: np.random.Generator, num: int) -> Array:
    """Unit vectors in all directions alike, shape (num, 3)."""
    direction = rng.normal(size=(num, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _turned(vector: Array, rotation: Array) -> Array:
    """Vectors turned about `rotation` by its length in radians (Rodrigues), shapes (n, 3)."""
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)
    axis = rotation / np.maximum(angle, 1e-300)
    along = (axis * vector).sum(axis=1, keepdims=True) * axis
    return along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector)
