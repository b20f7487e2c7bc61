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
from training.device.networks import stacked_actor, stacked_ensemble
from training.experience.replay import Batch

Make = Callable[..., TD3[BackboneNumbers]]
ROWS = 32
LEARNERS = {name: one.learner for name, one in ALGORITHMS.items() if one.learner}


def _stacks(
    algorithm: TD3[BackboneNumbers],
) -> tuple[list[Layer], list[Layer], list[Layer], list[Layer]]:
    """Copy actor, critics, target actor and target critics."""
    actors = algorithm.actor, algorithm.target_actor
    critics = algorithm.critics.ensemble, algorithm.target_critics.ensemble
    actor, target_actor = (stacked_actor(network) for network in actors)
    ensemble, target_ensemble = (stacked_ensemble(e, e.rows) for e in critics)
    return actor, ensemble, target_actor, target_ensemble


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
    actor, critics = (
        torch.optim.Adam(parameters(stack), lr=learner.learning_rate) for stack in stacks[:2]
    )
    networks = Networks(*stacks, actor, critics, torch.zeros((), dtype=torch.int64))
    encode, reference = algorithm.actor.encoder, GeneratorDraws(draws[1])
    generator = torch.Generator().manual_seed(2)
    seen = _batch(robot, dtype, generator)
    algorithm.show(seen.observation, algorithm.actor.to_command(seen.action))
    shown = encode(seen.observation), seen.action
    for _ in range(updates):
        batch = _batch(robot, dtype, generator)
        algorithm.update(batch)
        batch = batch._replace(
            observation=encode(batch.observation), next_observation=encode(batch.next_observation)
        )
        turn = algorithm.updates % learner.policy_delay == 0
        update(networks, batch, learner, reference, shown, actors_turn=turn)
    tolerance = 1e-10 if dtype == torch.float64 else 1e-4
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
