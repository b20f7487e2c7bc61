"""CLASP: clone-anchored, self-imitating learning from sparse rewards; BATD3's means put to another use."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from training.algorithms.td3 import IMITATING, TD3
from training.experience.replay import Batch


class CLASP(TD3):
    """The actor begins as the clone, is let go of as the critics learn to judge it, and holds on to what went well.

    The replay buffer begins as BATD3's does, with the demonstrations and the clone's successes. The clone does not
    assist targets, though, but the actor, which starts as the clone (`clone_start`) and has two more terms in its loss:

    - w |pi(s) - a_BC(s)|^2, w falling linearly from `clone_anchor` to `anchor_floor`;
    - `self_imitation` (G - V)+ |pi(s) - a|^2, where G is the discounted return that followed (s, a) and V what a critic
      expects of pi(s): self-imitation learning (Oh et al. 2018, eq. 2). Exploration noise shakes the arm off the paths
      it knows, and this shows it which of the ways back were good ones. It fades as nothing is better any more.

    With `scaled_values`, which its presets leave off, these are against values divided by their mean magnitude, as in
    TD3+BC (Fujimoto and Gu 2021), whose regularization never ends. One critic, drawn at random, judges the actor.
    """

    uses_demonstrations: ClassVar[bool] = True
    uses_clone: ClassVar[bool] = True
    uses_rollouts: ClassVar[bool] = True
    heeds: ClassVar[frozenset[str]] = IMITATING | {"scaled_values"}

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        learner = self.learner
        judge = int(torch.randint(learner.critics, (), generator=self._generator))
        value = self.critics(encoded, action, [judge])[0]
        expected = value.detach()
        loss = -value.mean()
        if learner.scaled_values:
            loss = loss / expected.abs().mean().clamp_min(1e-3)
        return (
            loss
            + self.anchor_loss(action, batch)
            + self.self_imitation_loss(action, batch, expected)
        )
