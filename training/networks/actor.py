"""The deterministic policy network."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot
from training.networks.encoder import Encoder
from training.networks.mirror_symmetry import MirrorSymmetry

Activation = Literal["tanh", "relu"]


class Actor(nn.Module):
    """Map observations to servo set-points; scaling and servo travel are part of the module.

    `forward` maps encoded observations to actions in [-1, 1], `act` maps observations to these
    actions, and `command` maps observations to set-points in [m].

    Args:
        robot: the description.
        with_error: see :class:`Encoder`.
        hidden: widths of the hidden layers.
        activation: after each hidden layer.
        mirror_symmetry: let `act` and `command` go through :class:`MirrorSymmetry`.
    """

    eta: Tensor
    """Minus the command of the largest pull, which is the action -1; shape (C,)."""

    def __init__(
        self,
        robot: Robot,
        with_error: bool,
        hidden: tuple[int, ...],
        activation: Activation,
        mirror_symmetry: bool = False,
    ) -> None:
        super().__init__()
        self.mirror_symmetry = MirrorSymmetry(robot) if mirror_symmetry else None
        self.encoder = Encoder(robot, with_error)
        layers: list[nn.Module] = []
        width = self.encoder.size
        for size in hidden:
            layers += [nn.Linear(width, size), nn.Tanh() if activation == "tanh" else nn.ReLU()]
            width = size
        self.net = nn.Sequential(*layers, nn.Linear(width, robot.num_cables))
        eta = torch.tensor([-servo.full for servo in robot.servos], dtype=torch.float32)
        self.register_buffer("eta", eta)

    def forward(self, encoded: Tensor) -> Tensor:
        """Return actions in [-1, 1]: (..., encoder.size) -> (..., C)."""
        return torch.tanh(self.net(encoded))

    def to_command(self, action: Tensor) -> Tensor:
        """Convert actions in [-1, 1] to commands from full pull to none, in [m] or [N]."""
        return (action - 1) * (self.eta / 2)

    def from_command(self, command: Tensor) -> Tensor:
        """Convert commands from full pull to none, in [m] or [N], to actions in [-1, 1]."""
        return command / (self.eta / 2) + 1

    def act(self, observation: Tensor) -> Tensor:
        """Return actions in [-1, 1]: (..., observation size) -> (..., C)."""
        if self.mirror_symmetry is None:
            return self(self.encoder(observation))
        image = self.mirror_symmetry(observation)
        return self(self.encoder(image.observation)).gather(-1, image.cables)

    def command(self, observation: Tensor) -> Tensor:
        """Return set-points in [m]: (..., observation size) -> (..., C)."""
        return self.to_command(self.act(observation))
