"""CLASP: clone-anchored, self-imitating learning from sparse rewards, with the means of BATD3."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from training.algorithms.imitation import Imitation, anchor_loss, self_imitation_loss
from training.algorithms.td3 import TD3, TD3Numbers
from training.config.learner import CloneRollouts, CloneStart, Count, Demonstrated, NotNegative
from training.experience.replay import Batch


class CLASPNumbers(TD3Numbers, CloneStart, Imitation, Demonstrated, CloneRollouts):
    """The numbers of CLASP."""

    clone_start: bool = True
    """Start the actor from behaviour cloning instead of from random weights."""
    clone_anchor: NotNegative = 0.7
    """Weight w in the actor's loss of its squared distance from the clone's action."""
    anchor_updates: Count = 2_000
    """Updates in which that weight falls linearly."""
    self_imitation: NotNegative = 10.0
    """Weight in the actor's loss of its squared distance from actions after which an episode went
    better than a critic expects of the actor, times how much better."""


class CLASP(TD3[CLASPNumbers]):
    """The actor starts as the clone, is let go of slowly, and holds on to what went well.

    The replay buffer begins as BATD3's does, with the demonstrations and the clone's successes. The
    clone does not assist targets but the actor, which starts as the clone and has two more terms in
    its loss:

    - w |pi(s) - a_BC(s)|^2, w falling linearly from `clone_anchor` to `anchor_floor`;
    - `self_imitation` (G - V)+ |pi(s) - a|^2, where G is the discounted return that followed (s, a)
      and V what a critic expects of pi(s): self-imitation learning (Oh et al. 2018, eq. 2).
      Exploration noise shakes the arm off the paths it knows; this term shows the actor which ways
      back were good. It fades as nothing is better any more.

    One critic, drawn at random, judges the actor.
    """

    uses_demonstrations: ClassVar[bool] = True
    uses_clone: ClassVar[bool] = True
    uses_rollouts: ClassVar[bool] = True

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        judge = int(torch.randint(self.learner.critics, (), generator=self._generator))
        value = self.critics(encoded, action, [judge])[0]
        loss = -value.mean() + anchor_loss(self.learner, self.updates, action, batch)
        return loss + self_imitation_loss(self.learner, action, batch, value.detach())
