"""The actor's actions and commands."""

from __future__ import annotations

import torch

from cdcsr.robot.description import Robot
from training.networks.actor import Actor


def test_commands_span_the_servos_travel(paper: Robot) -> None:
    actor = Actor(paper, False, (4,), "tanh")
    eta = torch.tensor([servo.eta for servo in paper.servos], dtype=torch.float32)
    ones = torch.ones(paper.num_cables)
    torch.testing.assert_close(actor.to_command(-ones), -eta)
    torch.testing.assert_close(actor.to_command(ones), 0 * eta)
    action = torch.rand(6, paper.num_cables) * 2 - 1
    torch.testing.assert_close(actor.from_command(actor.to_command(action)), action)
