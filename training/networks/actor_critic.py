"""Networks: a fixed encoding of the observation, deterministic actors, and ensembles of critics."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import (
    TARGET,
    TIP_POSITION,
    input_offset,
    input_scale,
    observation_size,
)
from training.networks.compiled_ensemble import Ensemble
from training.networks.mirror import Folding

_ERROR_SCALE = 0.1
"""Scale of the vector from tip to target, in [m]."""

Activation = Literal["tanh", "relu"]


class Encoder(nn.Module):
    """Scales eq. (1) by the range in which each number is useful, not by how little it moves in clean runs.

    Base position scaled to millimetres, say, would make a policy that centimetres of noise on it destroy.

    Args:
        robot: positions are centred on its workspace.
        with_error: append the scaled vector from tip to target; linear in the rest, but hard to learn.
    """

    offset: Tensor
    scale: Tensor

    def __init__(self, robot: Robot, with_error: bool) -> None:
        super().__init__()
        self.register_buffer("offset", torch.tensor(input_offset(robot), dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(input_scale(robot), dtype=torch.float32))
        self.with_error = with_error
        self.size = observation_size(robot) + 3 * with_error

    def forward(self, observation: Tensor) -> Tensor:
        """(..., 23 + C) -> (..., size)."""
        encoded = (observation - self.offset) / self.scale
        if not self.with_error:
            return encoded
        error = (observation[..., TARGET] - observation[..., TIP_POSITION]) / _ERROR_SCALE
        return torch.cat([encoded, error], dim=-1)


class Actor(nn.Module):
    """A deterministic policy: observation -> servo set-points, everything it needs inside.

    `forward` maps encoded observations to actions in [-1, 1]; `act` goes from observation to those, and `command` to
    set-points.

    Args:
        robot: the description.
        with_error: of the encoder.
        hidden: widths of the hidden layers.
        activation: after each of them.
        symmetry: `act` and `command` fold what they see, see :class:`Folding`.
    """

    eta: Tensor

    def __init__(
        self,
        robot: Robot,
        with_error: bool,
        hidden: tuple[int, ...],
        activation: Activation,
        symmetry: bool = False,
    ) -> None:
        super().__init__()
        self.folding = Folding(robot) if symmetry else None
        self.encoder = Encoder(robot, with_error)
        layers: list[nn.Module] = []
        width = self.encoder.size
        for size in hidden:
            layers += [nn.Linear(width, size), nn.Tanh() if activation == "tanh" else nn.ReLU()]
            width = size
        self.net = nn.Sequential(*layers, nn.Linear(width, robot.num_cables))
        self.register_buffer(
            "eta", torch.tensor([servo.eta for servo in robot.servos], dtype=torch.float32)
        )

    def forward(self, encoded: Tensor) -> Tensor:
        """(..., encoder.size) -> (..., C) in [-1, 1]."""
        return torch.tanh(self.net(encoded))

    def to_command(self, action: Tensor) -> Tensor:
        """[-1, 1] -> set-points in [-eta, 0] m."""
        return (action - 1) * (self.eta / 2)

    def from_command(self, command: Tensor) -> Tensor:
        """Set-points in [-eta, 0] m -> [-1, 1]."""
        return command / (self.eta / 2) + 1

    def act(self, observation: Tensor) -> Tensor:
        """(..., 23 + C) -> (..., C) in [-1, 1]."""
        if self.folding is None:
            return self(self.encoder(observation))
        folded = self.folding(observation)
        return self(self.encoder(folded.observation)).gather(-1, folded.cables)

    def command(self, observation: Tensor) -> Tensor:
        """(..., 23 + C) -> set-points (..., C) in [m]."""
        return self.to_command(self.act(observation))


class Critics(nn.Module):
    """E independent action-value networks."""

    def __init__(self, inputs: int, hidden: tuple[int, ...], num: int, layer_norm: bool) -> None:
        super().__init__()
        self.ensemble = Ensemble(inputs, hidden, num, layer_norm)

    def forward(self, encoded: Tensor, action: Tensor, members: list[int] | None = None) -> Tensor:
        """Action values, differentiable in state and action (and not in the parameters).

        Args:
            encoded: shape (B, inputs - C).
            action: shape (B, C), in [-1, 1].
            members: which critics, Z of them; None for all.

        Returns:
            Shape (E, B), or (Z, B).
        """
        return self.ensemble(torch.cat([encoded, action], dim=-1), members)

    def regress(self, encoded: Tensor, action: Tensor, target: Tensor) -> Tensor:
        """Set the parameters' gradient to that of the critics' mean squared errors, summed over critics.

        Args:
            encoded: shape (B, inputs - C).
            action: shape (B, C), in [-1, 1].
            target: shape (B,), for every critic.

        Returns:
            Action values, shape (E, B).
        """
        return self.ensemble.regress(torch.cat([encoded, action], dim=-1), target)
