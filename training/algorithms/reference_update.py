"""One update of each algorithm in plain PyTorch: stacked networks, batched products, autograd.

The algorithms compute their critics with :mod:`training.networks.compiled_ensemble`, which is
faster on a processor. Their updates must equal this one, random draw for random draw; the tests
run both side by side. On a graphics card this is the update itself: see :mod:`training.device`.

Shapes: B transitions, E critics, C cables; F numbers of an encoded observation. "..." stands for
nothing, or for runs that learn side by side and do not know of each other.

Sources: TD3 is Fujimoto et al. 2018, the random subset of critics is REDQ (Chen et al. 2021,
eq. 1), BATD3's target is Tian et al., eqs. 5 to 7, RBL's soft Q-filter is Haldar et al. 2022,
eq. 6, and self-imitation is Oh et al. 2018, eq. 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Generator, Tensor
from torch.nn import functional

from training.algorithms.batd3 import AssistedNumbers
from training.algorithms.clasp import CLASPNumbers
from training.algorithms.imitation import Imitation
from training.algorithms.rbl import RBLNumbers
from training.algorithms.td3 import BackboneNumbers, TD3Numbers
from training.experience.replay import Batch

Activation = Callable[[Tensor], Tensor]


class Layer(NamedTuple):
    """One layer of E networks side by side."""

    weight: Tensor
    """(..., E, n, m)."""
    bias: Tensor
    """(..., E, 1, m)."""
    gain: Tensor | None = None
    shift: Tensor | None = None
    """The gain and shift of LayerNorm, (..., E, 1, m), or None."""


@dataclass
class Networks:
    """The actor (a stack of one), E critics, their averaged copies and their optimizers."""

    actor: list[Layer]
    critics: list[Layer]
    target_actor: list[Layer]
    target_critics: list[Layer]
    actor_optimizer: torch.optim.Optimizer
    critic_optimizer: torch.optim.Optimizer
    updates: Tensor
    """How many updates have begun, a whole number of shape ()."""


class Draws(Protocol):
    """Draw what an update needs at random."""

    def normal(self, like: Tensor) -> Tensor:
        """Return normal deviates of the shape of a tensor."""
        ...

    def uniform(self, like: Tensor) -> Tensor:
        """Return numbers from 0 to 1 of the shape of a tensor."""
        ...

    def below(self, limit: int, num: int) -> Tensor:
        """Return whole numbers from 0 to limit - 1, shape (..., num)."""
        ...

    def subset(self, limit: int, num: int) -> Tensor:
        """Return as many different whole numbers below a limit, shape (..., num)."""
        ...


class GeneratorDraws:
    """The draws of the algorithms: those of one run, from PyTorch's generator."""

    def __init__(self, generator: Generator) -> None:
        self._generator = generator

    def normal(self, like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=self._generator)

    def uniform(self, like: Tensor) -> Tensor:
        return torch.rand(like.shape, generator=self._generator)

    def below(self, limit: int, num: int) -> Tensor:
        return torch.randint(limit, (num,), generator=self._generator)

    def subset(self, limit: int, num: int) -> Tensor:
        return torch.randperm(limit, generator=self._generator)[:num]


def update(
    networks: Networks,
    batch: Batch,
    learner: BackboneNumbers,
    draws: Draws,
    shown: tuple[Tensor, Tensor] | None = None,
    *,
    actors_turn: bool,
) -> dict[str, Tensor]:
    """Update the critics, and the actor if it is its turn, in place.

    Args:
        networks: the weights.
        batch: drawn from the replay; its observations are encoded, shape (..., B, F).
        learner: the numbers of the algorithm; their class says which losses apply.
        draws: draws target noise, subsets of critics and choices, in the algorithms' order.
        shown: for RBL the demonstrations: encoded observations (N, F) and actions (N, C).
        actors_turn: whether this is an update of the actor too, one of `policy_delay`.

    Returns:
        Losses and the mean value, each of shape (...).
    """
    networks.updates += 1
    with torch.no_grad():
        value = next_value(networks, batch, learner, draws)
        target = batch.reward + batch.discount * value  # n-step: both come from the replay
        if isinstance(learner, TD3Numbers) and learner.clip_targets:
            target = target.clamp(0, 1)
    found = values(networks.critics, batch.observation, batch.action)
    losses = (found - target.unsqueeze(-2)).square().mean(-1)
    descend(networks.critic_optimizer, losses.sum())
    metrics = {"critic_loss": losses.detach().mean(-1), "value": found.detach().mean((-1, -2))}
    average(networks.target_critics, networks.critics, learner.soft_update)
    if actors_turn:
        loss = actor_loss(networks, batch, learner, draws, shown)
        descend(networks.actor_optimizer, loss.sum())
        average(networks.target_actor, networks.actor, learner.soft_update)
        metrics["actor_loss"] = loss.detach()
    return metrics


def next_value(networks: Networks, batch: Batch, learner: BackboneNumbers, draws: Draws) -> Tensor:
    """Return the value at the end of each transition, shape (..., B)."""
    action = torch.tanh(output(networks.target_actor, batch.next_observation))
    noise = draws.normal(action) * learner.target_noise
    action = (action + noise.clamp(-learner.noise_clip, learner.noise_clip)).clamp(-1, 1)
    drawn = draw(learner, draws)

    def least(action: Tensor) -> Tensor:
        return chosen(values(networks.target_critics, batch.next_observation, action), drawn).amin(
            -2
        )

    policy = least(action)
    if not isinstance(learner, AssistedNumbers):
        return policy
    clone = least(batch.next_bc_action)
    probability = torch.sigmoid(learner.softmax_temperature * (clone - policy))
    return torch.where(draws.uniform(probability) < probability, clone, policy)


def actor_loss(
    networks: Networks,
    batch: Batch,
    learner: BackboneNumbers,
    draws: Draws,
    shown: tuple[Tensor, Tensor] | None,
) -> Tensor:
    """Return the loss of the actor, shape (...)."""
    logits = output(networks.actor, batch.observation)
    action = torch.tanh(logits)
    excess = functional.relu(logits.abs() - 3).square().mean((-1, -2))
    saturation = learner.saturation_penalty * excess
    one = isinstance(learner, CLASPNumbers)  # one critic judges
    drawn = draws.below(learner.critics, 1) if one else draw(learner, draws)
    value = chosen(values(networks.critics, batch.observation, action), drawn).mean(-2)
    if isinstance(learner, RBLNumbers) and shown is not None:
        clone = values(networks.critics, batch.observation, batch.bc_action)
        share = (chosen(clone, drawn).mean(-2) > value).to(value.dtype).mean(-1)
        rows = draws.below(len(shown[0]), learner.batch_size)
        imitated = torch.tanh(output(networks.actor, shown[0][rows]))
        imitation = (imitated - shown[1][rows]).square().mean((-1, -2))
        return saturation + share * imitation - (1 - share) * value.mean(-1)
    loss = saturation - value.mean(-1)
    if isinstance(learner, Imitation):
        left = (1 - networks.updates.to(value.dtype) / learner.anchor_updates).clamp_min(0)
        weight = learner.anchor_floor + left * (learner.clone_anchor - learner.anchor_floor)
        better = learner.self_imitation * (batch.outcome - value.detach()).clamp_min(0)
        loss = loss + weight * (action - batch.bc_action).square().mean((-1, -2))
        loss = loss + (better * (action - batch.action).square().mean(-1)).mean(-1)
    return loss


def outputs(
    layers: list[Layer], inputs: Tensor, activation: Activation = functional.relu
) -> Tensor:
    """Return the outputs of stacked networks: (..., B, n) -> (..., E, B, m)."""
    inputs = inputs.unsqueeze(-3)
    for weight, bias, gain, shift in layers[:-1]:
        inputs = inputs @ weight + bias
        if gain is not None and shift is not None:
            inputs = functional.layer_norm(inputs, inputs.shape[-1:]) * gain + shift
        inputs = activation(inputs)
    return inputs @ layers[-1].weight + layers[-1].bias


def output(actor: list[Layer], inputs: Tensor, activation: Activation = functional.relu) -> Tensor:
    """Return the outputs of a stack of one network: (..., B, n) -> (..., B, m)."""
    return outputs(actor, inputs, activation).squeeze(-3)


def values(critics: list[Layer], encoded: Tensor, action: Tensor) -> Tensor:
    """Return the action values of all critics: (..., B, F) and (..., B, C) -> (..., E, B)."""
    return outputs(critics, torch.cat([encoded, action], -1)).squeeze(-1)


def draw(learner: BackboneNumbers, draws: Draws) -> Tensor | None:
    """Return Z of E critics: all of them (None), or a random subset, shape (..., Z)."""
    num, drawn = learner.critics, learner.target_critics
    return None if drawn == num else draws.subset(num, drawn)


def chosen(values: Tensor, members: Tensor | None) -> Tensor:
    """Return the rows of some critics: (..., E, B) -> (..., Z, B)."""
    if members is None:
        return values
    return values.gather(-2, members[..., None].expand(*members.shape, values.shape[-1]))


def descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """Take one step down the gradient."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


@torch.no_grad()
def average(targets: list[Layer], sources: list[Layer], rate: float) -> None:
    """Move target weights towards the learning ones (Polyak averages)."""
    # One launch on a GPU instead of one for each tensor.
    torch._foreach_lerp_(  # type: ignore[attr-defined]  # not in the stubs
        parameters(targets), parameters(sources), rate
    )


def parameters(layers: list[Layer]) -> list[Tensor]:
    """Return all weights of a stack."""
    return [tensor for layer in layers for tensor in layer if tensor is not None]
