"""BATD3: behaviour cloning assisting TD3 (Tian et al., section IV), and its ablations (V-C)."""

from __future__ import annotations

from typing import ClassVar, TypeVar

import torch
from torch import Tensor

from training.algorithms.imitation import Imitation, anchor_loss, self_imitation_loss
from training.algorithms.td3 import TD3, TD3Numbers
from training.config.learner import CloneRollouts, CloneStart, Demonstrated, Members, NotNegative
from training.experience.replay import Batch


class HeldNumbers(TD3Numbers, CloneStart, Imitation):
    """The numbers of an actor that can be held to the clone."""


class AssistedNumbers(HeldNumbers):
    """The numbers of BATD3 whose replay buffer begins empty."""

    softmax_temperature: NotNegative = 10.0
    """Factor rho in the softmax that chooses between clone and policy (eq. 6)."""


class BATD3Numbers(AssistedNumbers, Demonstrated, CloneRollouts):
    """The numbers of BATD3."""


class WithoutAssistanceNumbers(HeldNumbers, Demonstrated, CloneRollouts):
    """The numbers of BATD3 whose targets ignore the clone."""


class WithoutEnsembleNumbers(BATD3Numbers):
    """The numbers of BATD3 with the pair of critics that TD3 has."""

    critics: Members = 2
    """Number E of critics in the ensemble."""


H = TypeVar("H", bound=HeldNumbers)
A = TypeVar("A", bound=AssistedNumbers)


class Held(TD3[H]):
    """TD3 with a clone; the actor can be held to it, as CLASP's is, but the presets do not."""

    uses_demonstrations: ClassVar[bool] = True
    uses_clone: ClassVar[bool] = True
    uses_rollouts: ClassVar[bool] = True

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        values = self.drawn_values(encoded, action)
        loss = -values.mean() + anchor_loss(self.learner, self.updates, action, batch)
        return loss + self_imitation_loss(self.learner, action, batch, values.detach().mean(0))


class BATD3(Held[A]):
    """TD3 whose targets may follow the clone, and whose replay begins with demonstrations.

    The replay buffer is pre-filled with the demonstrations and the clone's successful episodes.
    Every target draws its action from {the clone's, the target policy's} with probabilities
    softmax(rho Q') (eqs. 5 to 7). Only the learned policy acts.
    """

    def next_value(self, encoded: Tensor, batch: Batch) -> Tensor:
        """Return the value of the drawn action (eqs. 5 to 7), shape (B,).

        Both candidates are valued at once, so the drawn one needs no second evaluation.
        """
        both = torch.cat([batch.next_bc_action, self.smoothed_target_action(encoded)])
        clone, policy = self.target_value(torch.cat([encoded, encoded]), both).chunk(2)
        # A softmax over two is the logistic function of their difference.
        probability = torch.sigmoid(self.learner.softmax_temperature * (clone - policy))
        follows = torch.rand(probability.shape, generator=self._generator) < probability
        return torch.where(follows, clone, policy)


class WithoutAssistance(Held[WithoutAssistanceNumbers]):
    """BATD3 whose targets ignore the clone, which only fills the replay buffer."""


class WithoutPrefill(BATD3[AssistedNumbers]):
    """BATD3 whose replay buffer begins empty."""

    uses_demonstrations: ClassVar[bool] = False
    uses_rollouts: ClassVar[bool] = False
