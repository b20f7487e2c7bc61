"""RBL: TD3 regularized with the behaviour cloning loss (BATD3 paper, section V-B).

It differs from its source, ROT (Haldar et al. 2022), where the actor starts as the clone and the
cloning term is 12 times as strong for 8 cables.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from training.algorithms.bc import pairs
from training.algorithms.td3wd import TD3wD, TD3wDNumbers
from training.config.learner import CloneStart
from training.experience.replay import Batch


class RBLNumbers(TD3wDNumbers, CloneStart):
    """The numbers of RBL."""


class RBL(TD3wD[RBLNumbers]):
    """The actor also imitates, as much as the critics say that imitation still pays.

    With the soft Q-filter of Haldar et al. 2022 (eq. 6) the loss is (1 - share) of TD3's and share
    of the cloning loss; share is the part of the batch in which the clone's action has the higher
    value. The cloning loss is on a batch drawn from the demonstrations (BATD3 paper, eq. 4):
    elsewhere the clone may be wrong.
    """

    uses_clone: ClassVar[bool] = True

    def show(self, observations: Tensor, commands: Tensor) -> None:
        self._shown, self._wanted = pairs(self.actor, observations, commands)

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        drawn = self._draw_critics()
        values = self.critics(encoded, action, drawn).mean(0)
        with torch.no_grad():
            share = (self.critics(encoded, batch.bc_action, drawn).mean(0) > values).float().mean()
        chosen = torch.randint(
            len(self._shown), (self.learner.batch_size,), generator=self._generator
        )
        imitation = functional.mse_loss(self.actor(self._shown[chosen]), self._wanted[chosen])
        return share * imitation - (1 - share) * values.mean()
