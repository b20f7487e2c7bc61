"""Coulomb friction of cables in their guides.

Where a cable slides over a guide that turns it by the angle theta, its tensions before and behind
differ by the factor exp(mu theta) (the capstan equation of Euler and Eytelwein). With their mean T
this is a difference of 2 T tanh(mu theta / 2), whichever way the cable slides; while it sticks the
difference is smaller. So engines bound the friction at the guides of each body by this, with the
mean tension of the step before, and find it as they find other constraints: with the largest value
against the sliding, or with that under which nothing slides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing, rubbing, tail_jacobian, turning_angles

Array = NDArray[np.float64]


class Capstan:
    """The places at which a robot's cables rub, cable by cable from the base on: the guides of one
    body before each joint that a cable crosses, but for those of sheaths; R of them.

    Attributes:
        cable: the number of the cable at each place, shape (R,).
        joint: the joint behind each place, towards the anchor, shape (R,).
    """

    def __init__(self, robot: Robot) -> None:
        self._route = routing(robot)
        self._size = robot.num_cables, robot.num_links
        self.cable, self.joint = np.nonzero(rubbing(self._route))

    def bounds(self, coefficient: Array, hinges: Array, tension: Array, friction: Array) -> Array:
        """Return the largest friction at each place, shape (n, R), in [N].

        Args:
            coefficient: of each cable, shape (n, C).
            hinges: hinge angles, shape (n, H), in [rad].
            tension: of each cable at its slider, shape (n, C), in [N].
            friction: by how much the tension before each place exceeds that behind it, shape
                (n, R), in [N].
        """
        turned = turning_angles(self._route, hinges)[:, self.cable, self.joint]
        lost = np.zeros((len(tension), *self._size))
        lost[:, self.cable, self.joint] = friction
        behind = tension[..., None] - lost.cumsum(axis=-1)
        mean = behind[:, self.cable, self.joint] + friction / 2
        return 2 * np.maximum(mean, 0) * np.tanh(coefficient[:, self.cable] * turned / 2)

    def tails(self, hinges: Array) -> Array:
        """Return the derivatives of the cables' lengths from each place to the anchors by the
        hinges, shape (n, R, H), in [m/rad].

        Args:
            hinges: as for :meth:`bounds`.
        """
        return tail_jacobian(self._route, hinges)[:, self.cable, self.joint]
