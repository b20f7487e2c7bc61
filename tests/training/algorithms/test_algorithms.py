"""Each algorithm's targets and losses, against hand computations on tiny networks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.symmetry import images
from controllers.demonstrations import load
from tests.support.tiny import FRAME_SKIP, tiny_changes
from training.algorithms.batd3 import BATD3, WithoutAssistance
from training.algorithms.bc import BehaviourCloning, imitate, pairs
from training.algorithms.clasp import CLASP
from training.algorithms.drldr import DRLDR
from training.algorithms.rbl import RBL
from training.algorithms.registry import ALGORITHMS
from training.algorithms.td3 import TD3, BackboneNumbers
from training.config.learner import Cloning
from training.config.run_description import Changes
from training.experience.replay import Batch
from training.networks.actor import Actor
from training.run.train_options import Train
from training.run.trainer import train

Make = Callable[..., TD3[BackboneNumbers]]


def _value(
    algorithm: TD3[BackboneNumbers], member: int, encoded: torch.Tensor, action: torch.Tensor
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


LEARNERS = {name: one.learner for name, one in ALGORITHMS.items() if one.learner}


def _values(
    algorithm: TD3[BackboneNumbers], encoded: torch.Tensor, action: torch.Tensor
) -> torch.Tensor:
    """Return the values of all critics, shape (E, B)."""
    return algorithm.critics(encoded, action)


def test_rbl_imitates_what_was_shown_as_often_as_the_clone_is_better(
    make: Make, small_batch: Batch
) -> None:
    rbl = make(RBL, critics=2, target_critics=2)
    shown = small_batch.next_observation[:1].expand(2, -1)  # whichever is drawn
    wanted = torch.tensor([[0.3, -0.4, 0.1, 0.9]]).expand(2, -1)
    rbl.show(shown, rbl.actor.to_command(wanted))
    encoded = rbl.actor.encoder(small_batch.observation)
    with torch.no_grad():
        action = rbl.actor(encoded)
        own, clone = (_values(rbl, encoded, a).mean(0) for a in (action, small_batch.bc_action))
        one = int((clone > own).nonzero()[0])
        small_batch = small_batch._replace(bc_action=small_batch.bc_action.clone())
        small_batch.bc_action[one] = action[one]  # there the clone is no better now
        share = (clone > own).sum().item() / len(own) - 0.25
        assert share not in (0, 0.5, 1)  # or the test would not see the weights
        imitation = ((rbl.actor(rbl.actor.encoder(shown)) - wanted) ** 2).mean().item()
        expected = share * imitation - (1 - share) * own.mean().item()
        assert rbl.actor_loss(encoded, small_batch).item() == pytest.approx(expected, rel=1e-5)


def test_without_assistance_the_clone_does_not_matter(make: Make, small_batch: Batch) -> None:
    other = small_batch._replace(next_bc_action=-small_batch.next_bc_action)
    with torch.no_grad():
        values = []
        for batch in (small_batch, other):
            algorithm = make(WithoutAssistance)
            values.append(
                algorithm.next_value(algorithm.actor.encoder(batch.next_observation), batch)
            )
        td3 = make(TD3)
        expected = td3.next_value(td3.actor.encoder(small_batch.next_observation), small_batch)
    assert torch.equal(values[0], values[1])
    torch.testing.assert_close(values[0], expected)


def test_a_dense_reward_is_not_clipped(make: Make, small_batch: Batch) -> None:
    batch = small_batch._replace(reward=torch.full((4,), -2.0), discount=torch.zeros(4))
    for kind, target in ((DRLDR, -2.0), (TD3, 0.0)):
        algorithm = make(kind, **({} if kind is DRLDR else {"clip_targets": True}))
        with torch.no_grad():
            values = _values(algorithm, algorithm.actor.encoder(batch.observation), batch.action)
        loss = algorithm.update(batch)["critic_loss"].item()
        assert loss == pytest.approx(((values - target) ** 2).mean().item(), rel=1e-5)


@pytest.mark.parametrize(("updates", "weight"), [(0, 2.0), (250, 1.2), (500, 0.4), (900, 0.4)])
def test_clasp_lets_go_of_the_clone_linearly(
    make: Make, small_batch: Batch, updates: int, weight: float
) -> None:
    clasp = make(
        CLASP,
        critics=1,
        target_critics=1,
        clone_anchor=2.0,
        anchor_updates=500,
        anchor_floor=0.4,
        self_imitation=0.0,
    )
    clasp.updates = updates
    encoded = clasp.actor.encoder(small_batch.observation)
    with torch.no_grad():
        action = clasp.actor(encoded)
        value = _values(clasp, encoded, action)[0]
        distance = ((action - small_batch.bc_action) ** 2).mean().item()
        expected = -value.mean().item() + weight * distance
        assert clasp.actor_loss(encoded, small_batch).item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("kind", "critics"), [(CLASP, 1), (BATD3, 2)])
def test_what_went_better_than_expected_is_imitated_by_how_much(
    make: Make, small_batch: Batch, kind: type[TD3[BackboneNumbers]], critics: int
) -> None:
    learner = make(
        kind, critics=critics, target_critics=critics, self_imitation=3.0, clone_anchor=0.0
    )
    encoded = learner.actor.encoder(small_batch.observation)
    with torch.no_grad():
        action = learner.actor(encoded)
        value = _values(learner, encoded, action).mean(0)
        batch = small_batch._replace(outcome=value + torch.tensor([0.5, -0.5, 0.25, 0.0]))
        distance = ((action - batch.action) ** 2).mean(1)
        expected = -value.mean().item() + 3.0 * (0.5 * distance[0] + 0.25 * distance[2]).item() / 4
        assert learner.actor_loss(encoded, batch).item() == pytest.approx(expected, rel=1e-5)


def test_the_critic_that_judges_clasps_actor_is_drawn_anew(make: Make, small_batch: Batch) -> None:
    clasp = make(CLASP, critics=3, target_critics=2, clone_anchor=0.0, self_imitation=0.0)
    encoded = clasp.actor.encoder(small_batch.observation)
    with torch.no_grad():
        losses = {round(clasp.actor_loss(encoded, small_batch).item(), 6) for _ in range(60)}
        values = _values(clasp, encoded, clasp.actor(encoded)).mean(1)
    assert losses == {round(-value, 6) for value in values.tolist()}


def _few(algorithm: str) -> Changes:
    """Small numbers, and a clone that has hardly learned."""
    rollouts = {"bc_rollouts": 6} if "bc_rollouts" in _fields(algorithm) else {}
    updates = {"bc_updates": 400} if "bc_updates" in _fields(algorithm) else {}
    return tiny_changes(algorithm, batch_size=4, num_envs=2, **rollouts, **updates)


def _fields(algorithm: str) -> set[str]:
    return set(ALGORITHMS[algorithm].numbers.model_fields)


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_what_each_begins_with(tmp_path: Path, demonstrations: Path, algorithm: str) -> None:
    """Rows of the replay buffers after one update, before any episode has ended."""
    config = Train(
        out=tmp_path / "run",
        algorithm=algorithm,
        changes=_few(algorithm),
        demonstrations=demonstrations,
        frame_skip=FRAME_SKIP,
        evaluate_every=0,
        evaluate_episodes=1,
        stop_after=0.0,
        updates=2,
    )
    train(config)
    with safe_open(tmp_path / "run" / "state.safetensors", framework="pt") as file:
        sizes = {
            name: size for name, (_, size) in json.loads(file.metadata()["run"])["replays"].items()
        }
    shown = sum(
        episode.length + 1
        for episode in load(demonstrations, load_robot("paper").fingerprint, FRAME_SKIP)
    )
    if algorithm in ("td3", "her", "drldr", "batd3-no-prefill"):
        assert sizes == {"replay": 0}
    elif algorithm in ("td3wd", "rbl"):
        assert sizes == {"replay": shown}
    elif algorithm == "rlpd":
        assert sizes == {"replay": 0, "kept": shown}
    else:  # and the successes of a clone that has hardly learned
        assert sizes["replay"] >= shown
        assert (tmp_path / "run" / "clone" / "policy.json").exists()
    assert (tmp_path / "run" / "clone").exists() == LEARNERS[algorithm].uses_clone


def test_a_saturated_output_costs_the_square_of_its_excess(make: Make, small_batch: Batch) -> None:
    """The price is the mean of (|z| - 3)^2 over outputs z before tanh, where |z| is above 3."""
    td3, plain = (make(TD3, saturation_penalty=price) for price in (0.5, 0.0))
    with torch.no_grad():
        for learner in (td3, plain):
            list(learner.actor.parameters())[-1].copy_(torch.tensor([4.0, -5.0, 2.0, 0.0]))
        encoded = td3.actor.encoder(small_batch.observation)
        z = td3.actor.net(encoded).numpy()
        excess = np.maximum(np.abs(z) - 3, 0)
        cost = td3.actor_loss(encoded, small_batch) - plain.actor_loss(encoded, small_batch)
    assert (excess > 0).sum() >= 4
    assert cost.item() == pytest.approx(0.5 * (excess**2).mean(), rel=1e-4)


def test_a_clone_reports_every_hundredth_update_and_learns_ever_more_slowly(
    small_robot: Robot,
) -> None:
    """The learning rate falls as a cosine, to zero at the end: the last update moves nothing."""
    observations = torch.randn(20, observation_size(small_robot))
    commands = -torch.rand(20, small_robot.num_cables)
    learner = Cloning(hidden=(8,), bc_updates=250, batch_size=20, bc_learning_rate=1e-3)
    clone = BehaviourCloning(small_robot, learner, torch.Generator().manual_seed(0))
    seen: list[tuple[int, torch.Tensor]] = []
    weights = list(clone.actor.parameters())
    clone.fit(
        observations, commands, lambda update, _: seen.append((update, weights[0].detach().clone()))
    )
    assert [update for update, _ in seen] == [100, 200]
    early = (seen[1][1] - seen[0][1]).abs().max().item()
    late = (weights[0].detach() - seen[1][1]).abs().max().item()
    assert late < 0.3 * early
    last: list[int] = []
    clone = BehaviourCloning(small_robot, learner.changed(bc_updates=100), torch.Generator())
    clone.fit(observations, commands, lambda update, _: last.append(update))
    assert last == [100]  # the last of all updates too


def test_clone_learns_a_known_policy(small_robot: Robot) -> None:
    torch.manual_seed(0)
    observations = torch.randn(400, observation_size(small_robot)) * 0.1
    pull = torch.sigmoid(10 * observations[:, :1])
    commands = -pull * torch.tensor([5.0, 2.5, 0.0, 5.0])
    learner = Cloning(bc_updates=500, bc_learning_rate=3e-3, batch_size=128, hidden=(64, 64))
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


@pytest.mark.parametrize(("features", "more"), [("state", 0), ("state+error", 3)])
def test_networks_see_the_way_to_the_target_where_they_are_asked_to(
    make: Make, small_robot: Robot, features: str, more: int
) -> None:
    cloning = Cloning.model_validate({"features": features, "hidden": (8,), "symmetry": True})
    clone = BehaviourCloning(small_robot, cloning, torch.Generator()).actor
    learners = make(TD3, features=features, symmetry=True).actor, clone
    for actor in learners:
        assert actor.encoder.size == observation_size(small_robot) + more
        assert actor.mirror_symmetry is not None
    assert make(TD3, features=features).actor.mirror_symmetry is None


def test_all_images_of_a_demonstration_are_shown_as_one() -> None:
    """So a clone with mirror symmetry learns the same from each of them."""
    robot, random = load_robot("paper"), np.random.default_rng(0)
    actor = Actor(robot, True, (8,), "tanh", mirror_symmetry=True).double()
    observations = random.normal(size=(20, observation_size(robot)))
    commands = -5 * random.random((20, robot.num_cables))
    shown = [
        pairs(
            actor, *map(torch.from_numpy, (each.observation(observations), each.command(commands)))
        )
        for each in images(robot)
    ]
    assert len(shown) == 4
    for inputs, wanted in shown[1:]:
        torch.testing.assert_close(inputs, shown[0][0])
        torch.testing.assert_close(wanted, shown[0][1])
    assert shown[0][1].std(0).min() > 0.1


def test_imitation_is_the_same_for_clone_and_actor(small_robot: Robot) -> None:
    learner = Cloning(hidden=(16,), bc_updates=30)
    generator = torch.Generator().manual_seed(1)
    observations = torch.randn(50, observation_size(small_robot), generator=generator)
    commands = -5 * torch.rand(50, small_robot.num_cables, generator=generator)
    torch.manual_seed(0)
    clone = BehaviourCloning(small_robot, learner, torch.Generator().manual_seed(2))
    before = ((clone.actor.command(observations) - commands) ** 2).mean()
    torch.manual_seed(0)
    other = BehaviourCloning(small_robot, learner, torch.Generator().manual_seed(2)).actor
    clone.fit(observations, commands, lambda *_: None)
    imitate(
        other, learner, observations, commands, torch.Generator().manual_seed(2), lambda *_: None
    )
    torch.testing.assert_close(clone.actor.command(observations), other.command(observations))
    assert ((other.command(observations) - commands) ** 2).mean() < before
