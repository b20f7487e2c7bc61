"""Learning in one part of the space for all of them: the robot's mirror images, made use of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import TARGET
from cdcsr.tasks.symmetry import images


class Folded(NamedTuple):
    """Observations as a network is to see them."""

    observation: Tensor
    """(..., 23 + C) with the target on the workspace's side: with both mirrors, in the quarter that its centre is in,
    where x and y that are zero count as positive."""
    cables: Tensor
    """(..., C) where each cable's command is to be taken from, there and back."""


class Folding(nn.Module):
    """Replaces an observation by one of its images under the symmetries of the robot, the same for each of them.

    A policy that acts through it does in every image of a situation the image of what it does there, but for targets
    on a mirror plane, whose images tie. It has to learn, and to be shown, no more than one part of the space.

    Args:
        robot: the description.
    """

    signs: Tensor
    toward: Tensor
    orders: Tensor
    cables: Tensor

    def __init__(self, robot: Robot) -> None:
        super().__init__()
        known = images(robot)
        # Where learning is asked to happen: what encodes observations is centred there, too.
        toward = torch.tensor([-1.0 if x < 0 else 1.0 for x in robot.workspace.center[:2]])
        self.register_buffer("toward", toward, persistent=False)
        for name in ("signs", "order", "cables"):
            rows = torch.from_numpy(np.stack([getattr(image, name) for image in known]))
            rows = rows.float() if name == "signs" else rows
            self.register_buffer("orders" if name == "order" else name, rows, persistent=False)

    def forward(self, observation: Tensor) -> Folded:
        """Of observations (eq. (1)), shape (..., 23 + C)."""
        across = (
            observation[..., TARGET][..., None, :2] * self.signs[:, TARGET][:, :2] * self.toward
        ).sum(-1)
        which = across.argmax(-1)
        return Folded(
            observation.gather(-1, self.orders[which]) * self.signs[which], self.cables[which]
        )
