"""The fixed scaling of an observation before it enters a network."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import (
    TARGET,
    TIP_POSITION,
    error_scale,
    input_offset,
    input_scale,
    observation_size,
)


class Encoder(nn.Module):
    """Shift and scale each number of eq. (1) as :data:`cdcsr.tasks.observation.PARTS` says.

    Args:
        robot: positions are centred on its workspace.
        with_error: append the scaled vector from tip to target. It is a linear function of the
            rest, but a network learns it slowly.
    """

    offset: Tensor
    scale: Tensor
    error_scale: Tensor

    def __init__(self, robot: Robot, with_error: bool) -> None:
        super().__init__()
        self.register_buffer("offset", torch.tensor(input_offset(robot), dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(input_scale(robot), dtype=torch.float32))
        # In no file of weights, as it follows from the robot; a tensor, so that it has the type of
        # the other numbers, which exporters keep.
        error = torch.tensor(error_scale(robot), dtype=torch.float32)
        self.register_buffer("error_scale", error, persistent=False)
        self.with_error = with_error
        self.size = observation_size(robot) + 3 * with_error

    def forward(self, observation: Tensor) -> Tensor:
        """Encode observations: (..., observation size) -> (..., size)."""
        encoded = (observation - self.offset) / self.scale
        if not self.with_error:
            return encoded
        error = (observation[..., TARGET] - observation[..., TIP_POSITION]) / self.error_scale
        return torch.cat([encoded, error], dim=-1)
