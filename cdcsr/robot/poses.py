"""Where the links are at given joint angles; for pictures and for what is placed on the arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cdcsr.robot.description import Robot

Array = NDArray[np.float64]


class Poses(NamedTuple):
    """The poses of base and links in the world frame; J links."""

    axes: Array
    """The columns are the x, y and z axes of the base and of each link, shape (J + 1, 3, 3)."""
    joint: Array
    """The place of each joint, and of the tip, shape (J + 1, 3), in [m]."""


def link_poses(robot: Robot, position: Array) -> Poses:
    """Return the poses at one row of a Snapshot's position, shape (7 + C + 2 J,)."""
    turn = Rotation.from_quat(np.roll(position[3:7], -1))
    turns, place = [turn], position[:3] + turn.apply([0.0, 0.0, robot.top])
    joints = [place]
    hinges = position[7 + robot.num_cables :].reshape(-1, 2)
    for (link, _), angles in zip(robot.links, hinges, strict=True):
        turns.append(turns[-1] * Rotation.from_euler("XY", angles))
        joints.append(joints[-1] + turns[-1].apply([0.0, 0.0, link.length]))
    return Poses(np.array([turn.as_matrix() for turn in turns]), np.array(joints))
