"""Eq. (1) of the BATD3 paper as an array: where its parts are, and how to change its target."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot

Array = NDArray[np.float64]

TIP_POSITION, TIP_VELOCITY, TARGET, DISTANCE = slice(0, 3), slice(3, 6), slice(6, 9), 9
BASE_POSITION, BASE_QUATERNION = slice(10, 13), slice(13, 17)
"""Where parts of eq. (1) are in the observation."""


def with_target(observations: Array, target: Array) -> Array:
    """The same observations, shape (..., 23 + C), with a target elsewhere, shape (3,), and the distance to it."""
    moved = np.array(observations)
    moved[..., TARGET] = target
    moved[..., DISTANCE] = np.linalg.norm(target - moved[..., TIP_POSITION], axis=-1)
    return moved


def observation_size(robot: Robot) -> int:
    """Length of eq. (1)."""
    return 23 + robot.num_cables
