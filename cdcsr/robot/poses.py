"""Where links and hinges are at given angles, in plain NumPy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot

Array = NDArray[np.float64]


class Poses(NamedTuple):
    """The poses of base and links in the world frame; J links."""

    axes: Array
    """The columns are the x, y and z axes of the base and of each link, shape (J + 1, 3, 3)."""
    joint: Array
    """The place of each joint, and of the tip, shape (J + 1, 3), in [m]."""


def link_poses(robot: Robot, position: Array) -> Poses:
    """Return the poses at one row of a Snapshot's position, shape (7 + C + H,)."""
    from scipy.spatial.transform import Rotation  # an import of 0.4 s

    base = Rotation.from_quat(position[3:7], scalar_first=True).as_matrix()
    _, turns, joints = (part[0] for part in arms(robot, position[None, 7 + robot.num_cables :]))
    return Poses(np.concatenate([[base], base @ turns]), position[:3] + joints @ base.T)


def tip_at_start(robot: Robot) -> Array:
    """Return where the tip is at the start, in the world frame, shape (3,), in [m]."""
    position = [*robot.base.position, *robot.base.quaternion, *robot.num_cables * [0.0]]
    return link_poses(robot, np.array([*position, *robot.start_angles])).joint[-1]


class Arms(NamedTuple):
    """The arms of n copies in the base's frame; J links, H hinges."""

    axis: Array
    """The direction of each hinge, shape (n, H, 3)."""
    turn: Array
    """How each link is turned, shape (n, J, 3, 3); its columns are the link's axes."""
    joint: Array
    """The place of each link's joint and of the tip, shape (n, J + 1, 3), in [m]."""


def arms(robot: Robot, angles: Array) -> Arms:
    """Return where everything is.

    Args:
        robot: the description.
        angles: of the hinges, shape (n, H), in [rad].
    """
    num = len(angles)
    axis = np.empty((num, robot.num_hinges, 3))
    turns, joint = np.empty((num, robot.num_links, 3, 3)), np.empty((num, robot.num_links + 1, 3))
    turn, place = np.tile(np.eye(3), (num, 1, 1)), np.tile([0.0, 0.0, robot.first_joint], (num, 1))
    sin, cos = np.sin(angles)[..., None], np.cos(angles)[..., None]
    hinge = 0
    for n, (link, bends) in enumerate(robot.links):
        joint[:, n] = place
        for each in bends.hinges:
            a = "xyz".index(each.axis)
            b, c = (a + 1) % 3, (a + 2) % 3
            axis[:, hinge] = turn[:, :, a]
            first, second = turn[:, :, b], turn[:, :, c]
            turned = turn.copy()
            turned[:, :, b] = cos[:, hinge] * first + sin[:, hinge] * second
            turned[:, :, c] = cos[:, hinge] * second - sin[:, hinge] * first
            turn, hinge = turned, hinge + 1
        turns[:, n] = turn
        place = place + link.length * turn[:, :, 2]
    joint[:, -1] = place
    return Arms(axis, turns, joint)
