"""The actor, the critics and the encoder, by hand."""

from __future__ import annotations

import numpy as np
import torch

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import TARGET, TIP_POSITION, observation_size
from training.networks.actor import Actor
from training.networks.critics import Critics
from training.networks.encoder import Encoder


def test_commands_span_the_servos_travel(paper: Robot) -> None:
    actor = Actor(paper, False, (4,), "tanh")
    eta = torch.tensor([servo.eta for servo in paper.servos], dtype=torch.float32)
    ones = torch.ones(paper.num_cables)
    torch.testing.assert_close(actor.to_command(-ones), -eta)
    torch.testing.assert_close(actor.to_command(ones), 0 * eta)
    action = torch.rand(6, paper.num_cables) * 2 - 1
    torch.testing.assert_close(actor.from_command(actor.to_command(action)), action)


def test_critics_take_state_and_action() -> None:
    critics = Critics(5 + 2, (8, 6), 4, layer_norm=True)
    encoded, action = torch.randn(3, 5), torch.rand(3, 2, requires_grad=True)
    values = critics(encoded, action, [1, 3])
    assert values.shape == (2, 3)
    values.sum().backward()
    assert action.grad is not None
    chosen = critics.regress(encoded, action.detach(), torch.zeros(3))[[1, 3]]
    assert torch.equal(chosen, values.detach())


def test_encodes_by_hand(paper: Robot) -> None:
    """Tip 15 cm above the workspace's centre (0.15 / 0.3 = 0.5), target 6 cm to its side."""
    observation = np.zeros(observation_size(paper))
    observation[TIP_POSITION] = np.add(paper.workspace.center, (0, 0, 0.15))
    observation[TARGET] = np.add(paper.workspace.center, (0.06, 0, 0))
    observation[13] = 1  # the base's quaternion, upright
    observation[-1] = -0.03  # the last cable's travel
    encoded = Encoder(paper, with_error=True)(torch.as_tensor(observation, dtype=torch.float32))
    size = observation_size(paper)
    expected = torch.zeros(size + 3)
    expected[2], expected[6], expected[size - 1] = 0.5, 0.2, -1
    expected[size:] = torch.tensor([0.6, 0, -1.5])  # from tip to target, in decimetres
    torch.testing.assert_close(encoded, expected)
    plain = Encoder(paper, with_error=False)(torch.as_tensor(observation, dtype=torch.float32))
    torch.testing.assert_close(plain, expected[:size])
