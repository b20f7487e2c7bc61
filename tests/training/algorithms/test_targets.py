"""Targets against hand computations on tiny networks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from training.algorithms.batd3 import BATD3
from training.algorithms.td3 import TD3
from training.experience.replay import Batch

Make = Callable[..., TD3[Any]]


def _value(
    algorithm: TD3[Any], member: int, encoded: torch.Tensor, action: torch.Tensor
) -> torch.Tensor:
    return algorithm.target_critics(encoded, action, [member])[0]


def test_td3_bootstraps_from_the_least_of_all_critics(make: Make, small_batch: Batch) -> None:
    td3, batch = make(TD3, critics=3, target_critics=3), small_batch
    encoded = td3.actor.encoder(batch.next_observation)
    action = td3.target_actor(encoded)
    expected = torch.stack([_value(td3, i, encoded, action) for i in range(3)]).min(0).values
    with torch.no_grad():
        torch.testing.assert_close(td3.next_value(encoded, batch), expected)


def test_redq_draws_every_pair_of_critics_alike(make: Make, small_batch: Batch) -> None:
    td3, batch = make(TD3, critics=3, target_critics=2), small_batch
    encoded = td3.actor.encoder(batch.next_observation)
    action = td3.target_actor(encoded)
    values = torch.stack([_value(td3, i, encoded, action) for i in range(3)])
    pairs = torch.stack([values[[i, j]].min(0).values for i, j in ((0, 1), (0, 2), (1, 2))])
    with torch.no_grad():
        mean = torch.stack([td3.target_value(encoded, action) for _ in range(600)]).mean(0)
    spread = pairs.std(0) / np.sqrt(600)
    assert ((mean - pairs.mean(0)).abs() < 5 * spread + 1e-6).all()


def test_target_noise_is_clipped(make: Make, small_batch: Batch) -> None:
    td3, batch = make(TD3, target_noise=5.0, noise_clip=0.3), small_batch
    encoded = td3.actor.encoder(batch.next_observation)
    difference = td3.smoothed_target_action(encoded) - td3.target_actor(encoded)
    assert difference.abs().max() <= 0.3 + 1e-6
    assert difference.abs().max() > 0.29


def test_batd3_draws_between_clone_and_policy_by_softmax(make: Make, small_batch: Batch) -> None:
    batd3, batch = make(BATD3, critics=2, target_critics=2, softmax_temperature=10.0), small_batch
    encoded = batd3.actor.encoder(batch.next_observation)
    with torch.no_grad():
        clone = batd3.target_value(encoded, batch.next_bc_action)
        policy = batd3.target_value(encoded, batd3.target_actor(encoded))
        drawn = torch.stack([batd3.next_value(encoded, batch) for _ in range(4000)])
    # Eq. (6) as printed, exponentials and all.
    probability = torch.exp(10 * clone) / (torch.exp(10 * clone) + torch.exp(10 * policy))
    is_clone = torch.isclose(drawn, clone)
    assert (is_clone | torch.isclose(drawn, policy)).all()
    spread = torch.sqrt(probability * (1 - probability) / 4000)
    assert ((is_clone.float().mean(0) - probability).abs() < 5 * spread + 1e-3).all()
