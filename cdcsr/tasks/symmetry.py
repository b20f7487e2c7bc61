"""Mirror images of a robot that are the robot itself, and what they make of its observations and commands.

A robot here is built around the z axis: its bodies are symmetric, and a hinge about x or y stays one in a mirror. So
its image in the plane x = 0, in y = 0, or in both (a half-turn) is itself if the cables of every segment are. What it
does when given the image of a command is then the image of what it does, base and all, in any engine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import mirror_order, mirror_signs

Array = NDArray[np.float64]

_TOLERANCE_DEG = 1e-6
_AXES = {"identity": (1, 1), "mirror_x": (-1, 1), "mirror_y": (1, -1), "half_turn": (-1, -1)}


@dataclass(frozen=True, eq=False)
class Image:
    """One way in which a robot is its own image; done twice, it undoes itself."""

    name: str
    """identity, mirror_x (x becomes -x), mirror_y, or half_turn, which is both."""
    signs: Array
    """(23 + C,) what each number of eq. (1) is multiplied by."""
    order: NDArray[np.int64]
    """(23 + C,) where it is taken from."""
    cables: NDArray[np.int64]
    """(C,) the cable that each cable is the image of."""

    def observation(self, observations: Array) -> Array:
        """What the image of the robot would see, shape (..., 23 + C), of eq. (1) in the world frame."""
        return observations[..., self.order] * self.signs

    def command(self, commands: Array) -> Array:
        """Set-points or actions for the image, shape (..., C)."""
        return commands[..., self.cables]


def images(robot: Robot) -> list[Image]:
    """All ways in which a robot is its own image, the identity first."""
    found = []
    for name, (x, y) in _AXES.items():
        cables = _cables(robot, x, y)
        if cables is not None:
            signs = mirror_signs(x, y, robot.num_cables)
            found.append(Image(name, signs, mirror_order(cables), np.array(cables)))
    return found


def _cables(robot: Robot, x: int, y: int) -> list[int] | None:
    """For each cable the one that it is the image of; None if one has none, or cables of one angle leave it open."""
    if x == y == 1:
        return list(range(robot.num_cables))
    cables: list[int] = []
    for segment in robot.segments:
        angles = np.array(segment.cables.angles_deg)
        turned = angles if x > 0 else 180 - angles
        turned = turned if y > 0 else -turned
        apart = np.abs((turned[:, None] - angles + 180) % 360 - 180)  # (image, cable)
        if (apart.min(0) > _TOLERANCE_DEG).any() or len(set(apart.argmin(0))) < len(angles):
            return None
        cables += (len(cables) + apart.argmin(0)).tolist()
    return cables
