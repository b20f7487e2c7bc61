"""Every algorithm's update equals the one in plain PyTorch, over many updates."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import pytest
import torch
from torch import Tensor

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import observation_size
from training.algorithms.clasp import CLASP
from training.algorithms.reference_update import (
    GeneratorDraws,
    Layer,
    Networks,
    parameters,
    update,
)
from training.algorithms.registry import ALGORITHMS, own_numbers
from training.algorithms.td3 import TD3, BackboneNumbers
from training.config.run_description import PresetName
from training.device.networks import side_by_side, stacked_actor, stacked_ensemble
from training.experience.replay import Batch

Make = Callable[..., TD3[BackboneNumbers]]
Stacks = tuple[list[Layer], list[Layer], list[Layer], list[Layer]]
ROWS = 32
LEARNERS = {name: one.learner for name, one in ALGORITHMS.items() if one.learner}


def _stacks(algorithm: TD3[BackboneNumbers]) -> Stacks:
    """Copy actor, critics, target actor and target critics."""
    actors = algorithm.actor, algorithm.target_actor
    critics = algorithm.critics.ensemble, algorithm.target_critics.ensemble
    actor, target_actor = (stacked_actor(network) for network in actors)
    ensemble, target_ensemble = (stacked_ensemble(e, e.rows) for e in critics)
    return actor, ensemble, target_actor, target_ensemble


def _networks(stacks: Stacks, rate: float) -> Networks:
    """Return actor, critics, target actor and target critics with new optimizers."""
    actor, critics = (torch.optim.Adam(parameters(stack), lr=rate) for stack in stacks[:2])
    return Networks(*stacks, actor, critics, torch.zeros((), dtype=torch.int64))


def _batch(robot: Robot, dtype: torch.dtype, generator: torch.Generator) -> Batch:
    """Draw a batch; rewards and outcomes lie on both sides of [0, 1]."""
    size, cables = observation_size(robot), robot.num_cables

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=dtype)

    def action() -> Tensor:
        return normal(ROWS, cables).clamp(-1, 1)

    return Batch(
        observation=normal(ROWS, size),
        action=action(),
        reward=normal(ROWS),
        discount=0.9 * (normal(ROWS) > 0),
        next_observation=normal(ROWS, size),
        bc_action=action(),
        next_bc_action=action(),
        outcome=2 * normal(ROWS),
    )


def _compare(
    robot: Robot,
    name: str,
    learner: BackboneNumbers,
    updates: int = 40,
    dtype: torch.dtype = torch.float64,
) -> None:
    """Update an algorithm and the reference side by side, and compare all weights."""
    torch.manual_seed(0)
    draws = [torch.Generator().manual_seed(1) for _ in range(2)]
    algorithm = LEARNERS[name](robot, learner, draws[0])
    for actor, critics in (
        (algorithm.actor, algorithm.critics),
        (algorithm.target_actor, algorithm.target_critics),
    ):
        critics.to(dtype)
        for parameter in actor.to(dtype).parameters():
            parameter.data *= 2  # some actions are saturated
    stacks = _stacks(algorithm)
    networks = _networks(stacks, learner.learning_rate)
    encode, reference = algorithm.actor.encoder, GeneratorDraws(draws[1])
    generator = torch.Generator().manual_seed(2)
    seen = _batch(robot, dtype, generator)
    algorithm.show(seen.observation, algorithm.actor.to_command(seen.action))
    shown = encode(seen.observation), seen.action
    tolerance = 1e-10 if dtype == torch.float64 else 1e-4
    for _ in range(updates):
        batch = _batch(robot, dtype, generator)
        found = algorithm.update(batch)
        batch = batch._replace(
            observation=encode(batch.observation), next_observation=encode(batch.next_observation)
        )
        turn = algorithm.updates % learner.policy_delay == 0
        metrics = update(networks, batch, learner, reference, shown, actors_turn=turn)
        assert set(found) == {"critic_loss", "value", *(["actor_loss"] if turn else [])}
        torch.testing.assert_close(found, metrics, rtol=tolerance, atol=tolerance)
    assert networks.updates == algorithm.updates == updates
    for ours, theirs in zip(stacks, _stacks(algorithm), strict=True):
        for a, b in zip(parameters(ours), parameters(theirs), strict=True):
            torch.testing.assert_close(a, b, rtol=tolerance, atol=tolerance)


def _small(name: str, preset: PresetName) -> BackboneNumbers:
    learner = own_numbers(name, preset)
    assert isinstance(learner, BackboneNumbers)
    return learner.changed(hidden=(16, 16), batch_size=ROWS, learning_rate=3e-3)


@pytest.mark.parametrize("preset", get_args(PresetName))
@pytest.mark.parametrize("name", LEARNERS)
def test_every_algorithm_equals_the_reference(
    small_robot: Robot, name: str, preset: PresetName
) -> None:
    _compare(small_robot, name, _small(name, preset))


@pytest.mark.parametrize("name", LEARNERS)
def test_every_option_equals_the_reference(small_robot: Robot, name: str) -> None:
    learner = _small(name, "paper-reading")
    numbers = {
        "clone_anchor": 0.7,
        "anchor_updates": 30,
        "anchor_floor": 0.2,
        "self_imitation": 5.0,
        "saturation_penalty": 0.1,
        "clip_targets": True,
        "layer_norm": True,
        "critics": 4,
        "target_critics": 2,
        "policy_delay": 3,
        "soft_update": 0.1,
    }
    known = type(learner).model_fields
    learner = learner.changed(**{key: value for key, value in numbers.items() if key in known})
    _compare(small_robot, name, learner)


class _SideBySide:
    """The draws of several runs."""

    def __init__(self, runs: list[GeneratorDraws]) -> None:
        self._runs = runs

    def normal(self, like: Tensor) -> Tensor:
        return torch.stack([run.normal(like[0]) for run in self._runs])

    def uniform(self, like: Tensor) -> Tensor:
        return torch.stack([run.uniform(like[0]) for run in self._runs])

    def below(self, limit: int, num: int) -> Tensor:
        return torch.stack([run.below(limit, num) for run in self._runs])

    def subset(self, limit: int, num: int) -> Tensor:
        return torch.stack([run.subset(limit, num) for run in self._runs])


@pytest.mark.parametrize("name", ["batd3", "clasp", "rbl"])
def test_runs_side_by_side_do_not_know_of_each_other(small_robot: Robot, name: str) -> None:
    """Three runs in tensors with one more axis learn, and report, what each does alone."""
    learner = _small(name, "paper-reading").changed(critics=4, target_critics=2, layer_norm=True)
    generator, runs = torch.Generator().manual_seed(0), range(3)
    networks, batches = [], []
    for _ in runs:
        torch.manual_seed(len(networks))
        algorithm = LEARNERS[name](small_robot, learner, generator)
        stacks, encode = _stacks(algorithm), algorithm.actor.encoder
        networks.append(_networks(stacks, learner.learning_rate))
        batch = _batch(small_robot, torch.float32, generator)
        seen, then = encode(batch.observation), encode(batch.next_observation)
        batches.append(batch._replace(observation=seen, next_observation=then))
    names = "actor", "critics", "target_actor", "target_critics"
    one, two, three, four = (
        side_by_side([getattr(each, name) for each in networks], torch.device("cpu"))
        for name in names
    )
    joined = _networks((one, two, three, four), learner.learning_rate)
    shown = batches[0].observation, batches[0].action
    draws_together = _SideBySide(
        [GeneratorDraws(torch.Generator().manual_seed(run)) for run in runs]
    )
    apart = [GeneratorDraws(torch.Generator().manual_seed(run)) for run in runs]
    batch = Batch(*map(torch.stack, zip(*batches, strict=True)))
    for turn in (False, True, True):
        all_metrics = update(joined, batch, learner, draws_together, shown, actors_turn=turn)
        for run in runs:
            alone, draws = networks[run], apart[run]
            metrics = update(alone, batches[run], learner, draws, shown, actors_turn=turn)
            mine = {key: value[run] for key, value in all_metrics.items()}
            torch.testing.assert_close(mine, metrics, rtol=1e-4, atol=1e-5)
    for run in runs:
        for stack in names:
            together, alone = (parameters(getattr(each, stack)) for each in (joined, networks[run]))
            for a, b in zip(together, alone, strict=True):
                torch.testing.assert_close(a[run], b, rtol=1e-3, atol=1e-4)


def test_single_precision_equals_the_reference(small_robot: Robot) -> None:
    _compare(small_robot, "td3", _small("td3", "tuned"), 5, torch.float32)


def test_same_seed_same_bits(make: Make, small_batch: Batch) -> None:
    first, second = make(CLASP, layer_norm=True), make(CLASP, layer_norm=True)
    for _ in range(4):
        first.update(small_batch)
        second.update(small_batch)
    for ours, theirs in zip(_stacks(first), _stacks(second), strict=True):
        for a, b in zip(parameters(ours), parameters(theirs), strict=True):
            assert torch.equal(a, b)
