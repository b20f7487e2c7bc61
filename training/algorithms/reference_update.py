"""One update of each algorithm in plain PyTorch: stacked networks, batched products, autograd.

The algorithms compute their critics with :mod:`training.networks.compiled_ensemble`, which is
faster on a processor. Their updates must equal this one, random draw for random draw; the tests
run both side by side. Shapes: B transitions, E critics, C cables; F numbers of an encoded
observation.

Sources: TD3 is Fujimoto et al. 2018, the random subset of critics is REDQ (Chen et al. 2021,
eq. 1), BATD3's target is Tian et al., eqs. 5 to 7, RBL's soft Q-filter is Haldar et al. 2022,
eq. 6, and self-imitation is Oh et al. 2018, eq. 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn import functional

from training.algorithms.batd3 import AssistedNumbers
from training.algorithms.clasp import CLASPNumbers
from training.algorithms.imitation import Imitation
from training.algorithms.rbl import RBLNumbers
from training.algorithms.td3 import BackboneNumbers, TD3Numbers
from training.experience.replay import Batch


class Layer(NamedTuple):
    """One layer of E networks side by side."""

    weight: Tensor
    """(E, n, m)."""
    bias: Tensor
    """(E, 1, m)."""
    gain: Tensor | None = None
    shift: Tensor | None = None
    """The gain and shift of LayerNorm, (E, 1, m), or None."""


@dataclass
class Networks:
    """The actor (a stack of one), E critics, their averaged copies and their optimizers."""

    actor: list[Layer]
    critics: list[Layer]
    target_actor: list[Layer]
    target_critics: list[Layer]
    actor_optimizer: torch.optim.Optimizer
    critic_optimizer: torch.optim.Optimizer
    updates: int = 0


def update(
    networks: Networks,
    batch: Batch,
    learner: BackboneNumbers,
    generator: Generator,
    shown: tuple[Tensor, Tensor] | None = None,
) -> None:
    """Update the critics, and the actor when its turn comes, in place.

    Args:
        networks: the weights.
        batch: drawn from the replay; its observations are encoded, shape (B, F).
        learner: the numbers of the algorithm; their class says which losses apply.
        generator: draws target noise, subsets of critics and choices, in the algorithms' order.
        shown: for RBL the demonstrations: encoded observations (N, F) and actions (N, C).
    """
    networks.updates += 1
    with torch.no_grad():
        value = next_value(networks, batch, learner, generator)
        target = batch.reward + batch.discount * value  # n-step: both come from the replay
        if isinstance(learner, TD3Numbers) and learner.clip_targets:
            target = target.clamp(0, 1)
    errors = values(networks.critics, batch.observation, batch.action) - target
    descend(networks.critic_optimizer, errors.square().mean(1).sum())
    average(networks.target_critics, networks.critics, learner.soft_update)
    if networks.updates % learner.policy_delay == 0:
        loss = actor_loss(networks, batch, learner, generator, shown)
        descend(networks.actor_optimizer, loss)
        average(networks.target_actor, networks.actor, learner.soft_update)


def next_value(
    networks: Networks, batch: Batch, learner: BackboneNumbers, generator: Generator
) -> Tensor:
    """Return the value at the end of each transition, shape (B,)."""
    action = torch.tanh(outputs(networks.target_actor, batch.next_observation)[0])
    noise = torch.randn(action.shape, generator=generator) * learner.target_noise
    action = (action + noise.clamp(-learner.noise_clip, learner.noise_clip)).clamp(-1, 1)
    drawn = draw(learner, generator)

    def least(action: Tensor) -> Tensor:
        return values(networks.target_critics, batch.next_observation, action)[drawn].amin(0)

    policy = least(action)
    if not isinstance(learner, AssistedNumbers):
        return policy
    clone = least(batch.next_bc_action)
    probability = torch.sigmoid(learner.softmax_temperature * (clone - policy))
    follows = torch.rand(probability.shape, generator=generator) < probability
    return torch.where(follows, clone, policy)


def actor_loss(
    networks: Networks,
    batch: Batch,
    learner: BackboneNumbers,
    generator: Generator,
    shown: tuple[Tensor, Tensor] | None,
) -> Tensor:
    """Return the loss of the actor."""
    logits = outputs(networks.actor, batch.observation)[0]
    action = torch.tanh(logits)
    saturation = learner.saturation_penalty * functional.relu(logits.abs() - 3).square().mean()
    if isinstance(learner, CLASPNumbers):  # one critic judges
        drawn = torch.randint(learner.critics, (1,), generator=generator)
    else:
        drawn = draw(learner, generator)
    value = values(networks.critics, batch.observation, action)[drawn].mean(0)
    if isinstance(learner, RBLNumbers) and shown is not None:
        clone = values(networks.critics, batch.observation, batch.bc_action)[drawn].mean(0)
        share = (clone > value).float().mean()
        chosen = torch.randint(len(shown[0]), (learner.batch_size,), generator=generator)
        imitated = torch.tanh(outputs(networks.actor, shown[0][chosen])[0])
        imitation = (imitated - shown[1][chosen]).square().mean()
        return saturation + share * imitation - (1 - share) * value.mean()
    loss = saturation - value.mean()
    if isinstance(learner, Imitation):
        left = max(0.0, 1 - networks.updates / learner.anchor_updates)
        weight = learner.anchor_floor + left * (learner.clone_anchor - learner.anchor_floor)
        better = learner.self_imitation * (batch.outcome - value.detach()).clamp_min(0)
        loss = loss + weight * (action - batch.bc_action).square().mean()
        loss = loss + (better * (action - batch.action).square().mean(1)).mean()
    return loss


def outputs(layers: list[Layer], inputs: Tensor) -> Tensor:
    """Return the outputs of stacked ReLU networks: (B, n) -> (E, B, m)."""
    for weight, bias, gain, shift in layers[:-1]:
        inputs = inputs @ weight + bias
        if gain is not None and shift is not None:
            inputs = functional.layer_norm(inputs, inputs.shape[-1:]) * gain + shift
        inputs = functional.relu(inputs)
    return inputs @ layers[-1].weight + layers[-1].bias


def values(critics: list[Layer], encoded: Tensor, action: Tensor) -> Tensor:
    """Return the action values of all critics: (B, F) and (B, C) -> (E, B)."""
    return outputs(critics, torch.cat([encoded, action], 1))[..., 0]


def draw(learner: BackboneNumbers, generator: Generator) -> Tensor:
    """Return Z of E critics: all of them, or a random subset."""
    num, drawn = learner.critics, learner.target_critics
    return torch.arange(num) if drawn == num else torch.randperm(num, generator=generator)[:drawn]


def descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """Take one step down the gradient."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


@torch.no_grad()
def average(targets: list[Layer], sources: list[Layer], rate: float) -> None:
    """Move target weights towards the learning ones (Polyak averages)."""
    for target, source in zip(parameters(targets), parameters(sources), strict=True):
        target.lerp_(source, rate)


def parameters(layers: list[Layer]) -> list[Tensor]:
    """Return all weights of a stack."""
    return [tensor for layer in layers for tensor in layer if tensor is not None]
