"""The critics' view of the compiled ensemble."""

from __future__ import annotations

import torch

from training.networks.critics import Critics


def test_critics_take_state_and_action() -> None:
    critics = Critics(5 + 2, (8, 6), 4, layer_norm=True)
    encoded, action = torch.randn(3, 5), torch.rand(3, 2, requires_grad=True)
    values = critics(encoded, action, [1, 3])
    assert values.shape == (2, 3)
    values.sum().backward()
    assert action.grad is not None
    chosen = critics.regress(encoded, action.detach(), torch.zeros(3))[[1, 3]]
    assert torch.equal(chosen, values.detach())
