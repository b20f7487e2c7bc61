"""BATD3: behaviour cloning assisting TD3 (Tian et al., section IV), and what is left of it without its parts."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from training.algorithms.td3 import IMITATING, TD3
from training.experience.replay import Batch


class BATD3(TD3):
    """TD3 whose targets may follow the behaviour clone, and whose replay begins with demonstrations.

    The replay buffer is pre-filled with the demonstrations and the clone's successful episodes. Every target
    draws its action from {the clone's, the target policy's} with probabilities softmax(rho Q') (eqs. 5 to 7).
    Only the learned policy acts. With `clone_anchor` and `self_imitation`, which its presets leave off, the actor is
    held to the clone and to what went well as CLASP's is.
    """

    uses_demonstrations: ClassVar[bool] = True
    uses_clone: ClassVar[bool] = True
    uses_rollouts: ClassVar[bool] = True
    heeds: ClassVar[frozenset[str]] = IMITATING | {"softmax_temperature", "target_choice"}

    def next_value(self, encoded: Tensor, batch: Batch) -> Tensor:
        """Eqs. (5) to (7). Both candidates are valued at once, so the one drawn needs no second evaluation."""
        both = torch.cat([batch.next_bc_action, self.smoothed_target_action(encoded)])
        clone, policy = self.target_value(torch.cat([encoded, encoded]), both).chunk(2)
        return torch.where(self._follow_clone(clone - policy), clone, policy)

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        values = self.drawn_values(encoded, action)
        loss = -values.mean() + self.anchor_loss(action, batch)
        return loss + self.self_imitation_loss(action, batch, values.detach().mean(0))

    def _follow_clone(self, advantage: Tensor) -> Tensor:
        """Where a target takes the clone's action, by how much higher its value is, shape (B,)."""
        if self.learner.target_choice == "hard":
            return advantage > 0
        if self.learner.target_choice == "scaled":
            advantage = advantage / advantage.std().clamp_min(1e-8)
        # A softmax over two is the logistic function of their difference.
        probability = torch.sigmoid(self.learner.softmax_temperature * advantage)
        return torch.rand(probability.shape, generator=self._generator) < probability


class WithoutAssistance(BATD3):
    """BATD3 whose targets do not look at the clone, which only fills the replay buffer (section V-C)."""

    heeds: ClassVar[frozenset[str]] = IMITATING

    def next_value(self, encoded: Tensor, batch: Batch) -> Tensor:
        return TD3.next_value(self, encoded, batch)


class WithoutPrefill(BATD3):
    """BATD3 whose replay buffer begins empty (section V-C)."""

    uses_demonstrations: ClassVar[bool] = False
    uses_rollouts: ClassVar[bool] = False
