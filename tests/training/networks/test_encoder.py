"""The encoder's numbers, by hand."""

from __future__ import annotations

import numpy as np
import torch

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import TARGET, TIP_POSITION, observation_size
from training.networks.encoder import Encoder


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
