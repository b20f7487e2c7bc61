"""Targets and losses against hand computations on tiny networks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import torch

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import observation_size
from training.algorithms.batd3 import BATD3
from training.algorithms.bc import BehaviourCloning
from training.algorithms.td3 import TD3
from training.config.run_config import Learner
from training.experience.collector import exploration_noise
from training.experience.replay import Batch

Make = Callable[..., TD3]


def _value(
    algorithm: TD3, member: int, encoded: torch.Tensor, action: torch.Tensor
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


def test_one_update_is_gradient_descent_on_the_squared_td_error(
    make: Make, small_batch: Batch
) -> None:
    td3, batch = make(TD3, critics=2, target_critics=2, policy_delay=100), small_batch
    with torch.no_grad():
        following = td3.actor.encoder(batch.next_observation)
        action = td3.target_actor(following)
        least = torch.minimum(_value(td3, 0, following, action), _value(td3, 1, following, action))
        target = batch.reward + batch.discount * least
        encoded = td3.actor.encoder(batch.observation)
        before = td3.critics(encoded, batch.action)
    metrics = td3.update(batch)
    assert metrics["critic_loss"].item() == pytest.approx(
        ((before - target) ** 2).mean().item(), rel=1e-5
    )
    with torch.no_grad():
        after = td3.critics(encoded, batch.action)
    assert ((after - target) ** 2).mean() < ((before - target) ** 2).mean()


def test_targets_are_clipped_only_if_asked(make: Make, small_batch: Batch) -> None:
    batch = small_batch._replace(reward=torch.full((4,), 3.0), discount=torch.zeros(4))
    losses = []
    for clip in (False, True):
        td3 = make(TD3, clip_targets=clip)
        with torch.no_grad():
            values = td3.critics(td3.actor.encoder(batch.observation), batch.action)
        losses.append(td3.update(batch)["critic_loss"].item())
        expected = ((values - (1.0 if clip else 3.0)) ** 2).mean().item()
        assert losses[-1] == pytest.approx(expected, rel=1e-5)


def test_actor_moves_at_its_turn_and_targets_follow(make: Make, small_batch: Batch) -> None:
    td3, batch = make(TD3, policy_delay=2, soft_update=0.25), small_batch
    weights = [p.clone() for p in td3.actor.parameters()]
    targets = [p.clone() for p in td3.target_critics.parameters()]
    td3.update(batch)
    assert all(torch.equal(p, w) for p, w in zip(td3.actor.parameters(), weights, strict=True))
    for new, old, source in zip(
        td3.target_critics.parameters(), targets, td3.critics.parameters(), strict=True
    ):
        torch.testing.assert_close(new, 0.75 * old + 0.25 * source)
    td3.update(batch)
    assert any(not torch.equal(p, w) for p, w in zip(td3.actor.parameters(), weights, strict=True))
    for new, old, source in zip(
        td3.target_actor.parameters(), weights, td3.actor.parameters(), strict=True
    ):
        torch.testing.assert_close(new, 0.75 * old + 0.25 * source)


def test_saturated_actor_pays(make: Make, small_batch: Batch) -> None:
    td3, batch = make(TD3, saturation_penalty=0.5, critics=1, target_critics=1), small_batch
    last = td3.actor.net[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.fill_(5.0)
    encoded = td3.actor.encoder(batch.observation)
    value = td3.critics(encoded, td3.actor(encoded)).mean()
    # |z| = 5 everywhere: (5 - 3)^2 = 4, times the weight.
    assert td3.actor_loss(encoded, batch).item() == pytest.approx(-value.item() + 2.0, rel=1e-5)


def test_clone_learns_a_known_policy(small_robot: Robot) -> None:
    torch.manual_seed(0)
    observations = torch.randn(400, observation_size(small_robot)) * 0.1
    pull = torch.sigmoid(10 * observations[:, :1])
    commands = -pull * torch.tensor([5.0, 2.5, 0.0, 5.0])
    learner = Learner(bc_updates=500, bc_learning_rate=3e-3, batch_size=128, hidden=(64, 64))
    clone = BehaviourCloning(small_robot, learner, torch.Generator().manual_seed(0))
    losses: list[float] = []
    clone.fit(observations, commands, lambda _, loss: losses.append(loss))
    error = (clone.actor.command(observations) - commands).abs().mean().item()
    assert error < 0.1  # of commands up to 5 m
    # Eq. (4) on actions in [-1, 1], which are commands over eta / 2.
    assert losses[-1] == pytest.approx(
        ((clone.actor.command(observations) - commands) / 2.5).square().mean(), rel=0.5
    )
    assert not any(p.requires_grad for p in clone.actor.parameters())


def test_the_learning_rate_falls_linearly_to_its_end(make: Make, small_batch: Batch) -> None:
    td3 = make(TD3, updates=4, learning_rate=0.1, final_learning_rate=0.2)
    rates = []
    for _ in range(5):
        td3.update(small_batch)
        rates.append(
            [
                optimizer.param_groups[0]["lr"]
                for optimizer in (td3.actor_optimizer, td3.critic_optimizer)
            ]
        )
    # 0.1 less a quarter of 0.08 each update, and no further than 0.02.
    np.testing.assert_allclose(rates, [[r, r] for r in (0.08, 0.06, 0.04, 0.02, 0.02)])


def test_noise_is_the_same_everywhere_or_climbs_a_ladder() -> None:
    learner = Learner(num_envs=5, exploration_noise=0.2)
    np.testing.assert_allclose(exploration_noise(learner), 0.2)
    ladder = exploration_noise(dataclasses.replace(learner, noise_ladder=True))
    np.testing.assert_allclose(ladder, [0, 0.1, 0.2, 0.3, 0.4])
