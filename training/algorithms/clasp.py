"""CLASP: clone-anchored learning from sparse rewards; BATD3 taken further."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from training.algorithms.batd3 import BATD3
from training.replay import Batch


class CLASP(BATD3):
    """The actor begins as a clone of the demonstrator and is let go of as the critics learn to judge it.

    On top of BATD3: the actor starts from behaviour cloning (`clone_start`) and its loss holds w |pi(s) - a_BC(s)|^2,
    w falling linearly from `clone_anchor` to zero. With `scaled_values`, which its presets leave off, that is against
    values divided by their mean magnitude, as in TD3+BC (Fujimoto and Gu 2021), whose regularization never ends.
    """

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        values = self.drawn_values(encoded, action)
        loss = -values.mean()
        if self.learner.scaled_values:
            loss = loss / values.detach().abs().mean().clamp_min(1e-3)
        weight = self.learner.clone_anchor * max(0.0, 1 - self.updates / self.learner.anchor_updates)
        return loss if weight == 0 else loss + weight * functional.mse_loss(action, batch.bc_action)
