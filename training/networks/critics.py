"""The ensemble of critics: action values of encoded states and actions."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from training.networks.compiled_ensemble import Ensemble


class Critics(nn.Module):
    """E independent action-value networks.

    Args:
        inputs: width of the encoded observation plus the number of cables C.
        hidden: widths of the hidden layers.
        num: E.
        layer_norm: normalise before each hidden activation.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], num: int, layer_norm: bool) -> None:
        super().__init__()
        self.ensemble = Ensemble(inputs, hidden, num, layer_norm)

    def forward(
        self, encoded: Tensor, action: Tensor, members: Sequence[int] | None = None
    ) -> Tensor:
        """Return action values, differentiable in state and action but not in the parameters.

        Args:
            encoded: shape (B, inputs - C).
            action: shape (B, C), in [-1, 1].
            members: indices of Z critics; None for all.

        Returns:
            Shape (E, B), or (Z, B).
        """
        return self.ensemble(torch.cat([encoded, action], dim=-1), members)

    def regress(self, encoded: Tensor, action: Tensor, target: Tensor) -> Tensor:
        """Set the gradient of the parameters to that of the squared errors.

        The loss is each critic's mean squared error, summed over critics.

        Args:
            encoded: shape (B, inputs - C).
            action: shape (B, C), in [-1, 1].
            target: shape (B,), the same for every critic.

        Returns:
            Action values, shape (E, B).
        """
        return self.ensemble.regress(torch.cat([encoded, action], dim=-1), target)
