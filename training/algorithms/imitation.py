"""Losses that hold an actor to its clone, and to actions that went well: for BATD3 and CLASP."""

from __future__ import annotations

import torch
from torch import Tensor

from training.config.learner import Count, Network, NotNegative
from training.experience.replay import Batch


class Imitation(Network):
    """The numbers of these losses."""

    clone_anchor: NotNegative = 0.0
    """Weight w in the actor's loss of its squared distance from the clone's action."""
    anchor_updates: Count = 4_000
    """Updates in which that weight falls linearly."""
    anchor_floor: NotNegative = 0.0
    """The weight that it falls to."""
    self_imitation: NotNegative = 0.0
    """Weight in the actor's loss of its squared distance from actions after which an episode went
    better than a critic expects of the actor, times how much better."""


def anchor_loss(numbers: Imitation, updates: int, action: Tensor, batch: Batch) -> Tensor:
    """Return w |pi(s) - a_BC(s)|^2, a scalar.

    Args:
        numbers: w falls linearly from `clone_anchor` to `anchor_floor`.
        updates: how many updates have begun.
        action: the actor's, shape (B, C).
        batch: has the clone's actions.
    """
    left = max(0.0, 1 - updates / numbers.anchor_updates)
    weight = numbers.anchor_floor + left * (numbers.clone_anchor - numbers.anchor_floor)
    return weight * distance(action, batch.bc_action).mean() if weight > 0 else torch.zeros(())


def self_imitation_loss(
    numbers: Imitation, action: Tensor, batch: Batch, expected: Tensor
) -> Tensor:
    """Return `self_imitation` (G - V)+ |pi(s) - a|^2, a scalar (Oh et al. 2018, eq. 2).

    Args:
        numbers: the weight.
        action: the actor's, shape (B, C).
        batch: has the action a that was taken and the return G that followed it.
        expected: V, what critics expect of the actor's action, shape (B,).
    """
    if numbers.self_imitation == 0:
        return torch.zeros(())
    better = (batch.outcome - expected).clamp_min(0)
    return numbers.self_imitation * (distance(action, batch.action) * better).mean()


def distance(one: Tensor, other: Tensor) -> Tensor:
    """Return the mean over cables of the squared difference, shape (B,)."""
    return (one - other).square().mean(-1)
