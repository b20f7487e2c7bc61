"""The true path of each cable through its guides, for pictures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.robot.poses import Poses
from cdcsr.robot.routing import routing

Array = NDArray[np.float64]

_BENDS = 4
"""The number of straight lines that draw a bowed piece."""


class CablePaths:
    """Find where the cables of a robot run: from guide to guide, and from its slider to the first.

    A piece is a straight run between two guides; P pieces in all, cable by cable, each cable from
    the base to its anchor.

    Args:
        robot: the description.

    Attributes:
        cable: the cable that each piece belongs to, shape (P,).
    """

    def __init__(self, robot: Robot) -> None:
        self._route = route = routing(robot)
        self._first_joint = robot.first_joint
        # Each end of a run is a guide; a sheath is not drawn.
        runs = [
            (c, *run)
            for c, guides in enumerate(route.guides)
            for run in list(pairwise(guides))[int(route.first[c] > 0) :]
        ]
        self.cable = np.array([c for c, _, _ in runs], dtype=np.int64)
        ends = [(low, high) for _, low, high in runs]
        bodies = [[guide.body for guide in pair] for pair in ends]
        self._body = np.array(bodies, dtype=np.int64).reshape(-1, 2)
        self._joint = np.maximum(self._body - 1, 0)
        local = [[guide.place for guide in pair] for pair in ends]
        self._local = np.array(local, dtype=float).reshape(-1, 2, 3)
        self._local[self._body == 0, 2] -= robot.first_joint
        self._pieces_of = np.bincount(self.cable, minlength=len(route.joints))

    def pieces(self, poses: Poses) -> Array:
        """Return both ends of all pieces outside the base, shape (P, 2, 3), in the world, in [m].

        Args:
            poses: of the base and the links.
        """
        turned = np.einsum("peij,pej->pei", poses.axes[self._body], self._local)
        return poses.joint[self._joint] + turned

    def sliders(self, poses: Poses, travel: Array) -> Array:
        """Return the place of each slider and of its cable's first guide, shape (C, 2, 3), in [m].

        Args:
            poses: of the base and the links.
            travel: of the sliders, shape (C,), in [m].
        """
        route = self._route
        guide = np.full(len(travel), self._first_joint) - route.guide_offset
        heights = np.stack([guide - route.slider_offset + travel, guide], axis=1)
        across = np.repeat(route.place[:, None], 2, axis=1)
        local = np.concatenate([across, heights[..., None]], axis=2)
        # The first joint does not move in the base's frame, which tells where the base is.
        origin = poses.joint[0] - self._first_joint * poses.axes[0, :, 2]
        return origin + local @ poses.axes[0].T

    def bowed(self, pieces: Array, poses: Poses, slack: Array) -> Array:
        """Return the pieces as lines that are as long as their cables: slack ones bow outward.

        A cable shares its slack evenly among its pieces. A piece of length d with an excess e is
        drawn as half a sine wave of height 2/pi sqrt(d e), whose length is d + e for e << d.

        Args:
            pieces: from :meth:`pieces`.
            poses: of the base and the links.
            slack: by how much each cable is longer than its path, shape (C,), in [m].

        Returns:
            Lines, shape (P * bends, 2, 3), in [m].
        """
        start, end = pieces[:, 0], pieces[:, 1]
        length = np.linalg.norm(end - start, axis=1)
        excess = (np.maximum(slack, 0.0) / np.maximum(self._pieces_of, 1))[self.cable]
        height = 2 / np.pi * np.sqrt(length * excess)
        # Outward is away from the arm's axis, in the frame of the piece's lower body.
        local = self._local[:, 0] * (1.0, 1.0, 0.0)
        outward = np.einsum("pij,pj->pi", poses.axes[self._body[:, 0]], local)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        share = np.linspace(0, 1, _BENDS + 1)[:, None]
        lift = (height[:, None] * outward)[:, None] * np.sin(np.pi * share)
        points = start[:, None] + share * (end - start)[:, None] + lift
        return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)

    def of_lines(self, values: Array) -> Array:
        """Return a value of each cable, shape (C, ...), for each line of :meth:`bowed`."""
        return np.repeat(values[self.cable], _BENDS, axis=0)
