"""RBL: TD3 regularized with the behaviour cloning loss (BATD3 paper, section V-B)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from training.algorithms.td3wd import TD3wD
from training.replay import Batch


class RBL(TD3wD):
    """The actor also imitates, as much as the critics say that imitation still pays.

    With the soft Q-filter of Haldar et al. 2022 (eq. 6), the loss is (1 - share) of TD3's and share of the cloning
    loss, share being that part of the batch in which the clone's action has the higher value.
    """

    uses_clone: ClassVar[bool] = True

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        drawn = self._draw_critics()
        values = self.critics(encoded, action, drawn).mean(0)
        with torch.no_grad():
            share = (self.critics(encoded, batch.bc_action, drawn).mean(0) > values).float().mean()
        return share * functional.mse_loss(action, batch.bc_action) - (1 - share) * values.mean()
