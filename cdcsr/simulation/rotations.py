"""Rotation matrices, and where the base is at the start."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.robot.description import Robot

Array = NDArray[np.float64]


def rotation_matrix(quaternion: Array) -> Array:
    """Return the rotation matrices, shape (..., 3, 3), of unit quaternions w-x-y-z, (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def at_start(robot: Robot, points: ArrayLike) -> Array:
    """Return where points in the base's frame are in the world at the start.

    Args:
        robot: the description.
        points: shape (..., 3), in [m].

    Returns:
        The same shape; the same numbers if the base starts at the origin and is not turned.
    """
    turn = rotation_matrix(np.array(robot.base.quaternion))
    return np.asarray(points) @ turn.T + robot.base.position
