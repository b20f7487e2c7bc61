"""Tiny learners, batches and datasets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.observation import observation_size
from tests.support.small_study import small_study
from tests.support.tiny import FRAME_SKIP, untrained_policy
from training.algorithms.registry import ALGORITHMS
from training.algorithms.td3 import TD3, BackboneNumbers
from training.commands.demonstrate import demonstrate
from training.experience.replay import Batch
from training.policy import Policy

_SIZE = 4


@pytest.fixture(scope="session")
def small_robot() -> Robot:
    return load_robot("planar-single")


@pytest.fixture(scope="session")
def small_batch(small_robot: Robot) -> Batch:
    """Four transitions, of which one ends an episode."""
    generator = torch.Generator().manual_seed(0)
    size, cables = observation_size(small_robot), small_robot.num_cables

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator) * 2 - 1

    return Batch(
        uniform(_SIZE, size),
        uniform(_SIZE, cables),
        torch.rand(_SIZE, generator=generator),
        torch.tensor([0.9, 0.0, 0.81, 0.9]),
        uniform(_SIZE, size),
        uniform(_SIZE, cables),
        uniform(_SIZE, cables),
        torch.rand(_SIZE, generator=generator),
    )


@pytest.fixture(scope="session")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three episodes of reaching."""
    folder = tmp_path_factory.mktemp("data") / "demonstrations"
    demonstrate(out=folder, episodes=3, frame_skip=FRAME_SKIP)
    return folder


@pytest.fixture
def make(small_robot: Robot) -> Callable[..., TD3[BackboneNumbers]]:
    """Make algorithms with two layers of 16, no target noise and always the same weights."""

    def make(kind: type[TD3[BackboneNumbers]], **numbers: object) -> TD3[BackboneNumbers]:
        torch.manual_seed(3)
        (own,) = {
            one.numbers for one in ALGORITHMS.values() if one.learner is kind and not one.tuned
        }
        usual = {"hidden": (16, 16), "target_noise": 0.0, "batch_size": _SIZE}
        learner = own(**{**usual, **numbers})
        assert isinstance(learner, BackboneNumbers)
        return kind(small_robot, learner, torch.Generator().manual_seed(0))

    return make


@pytest.fixture
def policy(paper: Robot) -> Policy:
    """An untrained policy of the paper's robot."""
    return untrained_policy(paper)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """See :func:`small_study`."""
    return small_study(tmp_path / "study")
