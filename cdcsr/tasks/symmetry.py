"""Mirror images of a robot that are the robot itself; their effect on observations and commands.

The robot is built around the z axis: its bodies are symmetric, and the mirror image of a hinge
about x, y or z is such a hinge. So the image of the robot in the plane x = 0, in y = 0, or in both
(a half-turn) is the robot itself if the same holds for the cables of every segment, for the rest
angles and limits of all hinges, for gravity and for the place of the base. Given the image of a
command, the robot then does the image of what it does given the command, in any engine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import CABLE_TRAVEL, PARTS

Array = NDArray[np.float64]

_TOLERANCE_DEG = 1e-6
_AXES = {"identity": (1, 1), "mirror_x": (-1, 1), "mirror_y": (1, -1), "half_turn": (-1, -1)}


@dataclass(frozen=True, eq=False)
class Image:
    """A mirror image that is the robot itself; mirroring twice changes nothing."""

    name: str
    """identity, mirror_x (x becomes -x), mirror_y, or half_turn, which is both."""
    signs: Array
    """The factor on each number of eq. (1), shape (observation size,)."""
    order: NDArray[np.int64]
    """Where each number of eq. (1) is taken from, shape (observation size,)."""
    cables: NDArray[np.int64]
    """The cable that each cable is the image of, shape (C,)."""

    def observation(self, observations: Array) -> Array:
        """Return what the image of the robot observes, shape (..., observation size)."""
        return observations[..., self.order] * self.signs

    def command(self, commands: Array) -> Array:
        """Return the set-points or actions of the image, shape (..., C)."""
        return commands[..., self.cables]


def images(robot: Robot) -> list[Image]:
    """Return all mirror images that are the robot itself, the identity first."""
    found = []
    for name, (x, y) in _AXES.items():
        cables = _cables(robot, x, y)
        if cables is not None:
            first = CABLE_TRAVEL.start
            order = np.array([*range(first), *(first + cable for cable in cables)])
            found.append(Image(name, _signs(x, y, robot.num_cables), order, np.array(cables)))
    return found


def _cables(robot: Robot, x: int, y: int) -> list[int] | None:
    """Return the cable that each cable is the image of; None if one is the image of no cable, or if
    two cables at the same angle leave that open."""
    if x == y == 1:
        return list(range(robot.num_cables))
    axial = {"x": y, "y": x, "z": x * y}  # the sign that a hinge's angle gets
    for hinge in robot.hinges:
        if axial[hinge.axis] < 0 and (hinge.rest or hinge.lower != -hinge.upper):
            return None
    base = robot.base
    across = [vector[axis] for vector in (base.position, robot.gravity) for axis in _crossed(x, y)]
    if any(across) or base.quaternion != (1.0, 0.0, 0.0, 0.0):
        return None
    cables: list[int] = []
    for segment in robot.segments:
        if not segment.cable_angles:
            continue
        if segment.cables.paths:
            return None  # their images are not looked for
        angles = np.array(segment.cable_angles)
        turned = angles if x > 0 else 180 - angles
        turned = turned if y > 0 else -turned
        apart = np.abs((turned[:, None] - angles + 180) % 360 - 180)  # (image, cable)
        if (apart.min(0) > _TOLERANCE_DEG).any() or len(set(apart.argmin(0))) < len(angles):
            return None
        cables += (len(cables) + apart.argmin(0)).tolist()
    return cables


def _crossed(x: int, y: int) -> list[int]:
    """Return the axes whose direction a mirror changes."""
    return [axis for axis, sign in enumerate((x, y)) if sign < 0]


def _signs(x: int, y: int, num_cables: int) -> Array:
    """Return the factor that a mirror puts on each number of eq. (1).

    An axial vector, and so the vector part of a quaternion, keeps its component across the mirror
    plane; its other two components change their sign.

    Args:
        x: -1 if the plane x = 0 is a mirror, else 1.
        y: -1 if the plane y = 0 is a mirror, else 1.
        num_cables: the cables change places, but not the sign of their travel.
    """
    polar, axial = [x, y, 1], [y, x, x * y]
    signs = {
        "position": polar,
        "velocity": polar,
        "scalar": [1],
        "quaternion": [1, *axial],
        "axial vector": axial,
        "per cable": [1] * num_cables,
    }
    return np.concatenate([signs[part.kind] for part in PARTS]).astype(np.float64)
