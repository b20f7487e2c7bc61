"""Mirror symmetry: a policy that learns in one part of the space and acts in all of its images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import TARGET
from cdcsr.tasks.symmetry import images


class CanonicalImage(NamedTuple):
    """The mirror images of observations that a network sees."""

    observation: Tensor
    """(..., observation size), with the target on the workspace's side of every mirror plane.

    With both mirrors this is the quarter that holds the workspace's centre. A centre on a mirror
    plane counts as on its positive side."""
    cables: Tensor
    """(..., C), the cable from which each cable's command is taken, in both directions."""


class MirrorSymmetry(nn.Module):
    """Replace an observation by the same canonical image for all of its mirror images.

    A policy that acts through this module answers the image of a situation with the image of its
    answer. It learns, and is shown, one part of the space only. Targets on a mirror plane are an
    exception: two of their images are equally canonical.

    Args:
        robot: the description; :func:`images` finds its mirror planes.
    """

    signs: Tensor
    side: Tensor
    orders: Tensor
    cables: Tensor

    def __init__(self, robot: Robot) -> None:
        super().__init__()
        # The workspace's side of the planes x = 0 and y = 0; the encoder is centred there, too.
        side = torch.tensor([-1.0 if x < 0 else 1.0 for x in robot.workspace.center[:2]])
        known = images(robot)
        signs, orders, cables = (
            torch.from_numpy(np.stack(rows))
            for rows in zip(*((i.signs, i.order, i.cables) for i in known), strict=True)
        )
        for name, rows in (
            ("side", side),
            ("signs", signs.float()),
            ("orders", orders),
            ("cables", cables),
        ):
            self.register_buffer(name, rows, persistent=False)

    def forward(self, observation: Tensor) -> CanonicalImage:
        """Find the canonical images of observations, shape (..., observation size)."""
        targets = observation[..., TARGET][..., None, :2] * self.signs[:, TARGET][:, :2]
        chosen = (targets * self.side).sum(-1).argmax(-1)
        return CanonicalImage(
            observation.gather(-1, self.orders[chosen]) * self.signs[chosen], self.cables[chosen]
        )
