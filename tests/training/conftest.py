"""Tiny learners, batches and datasets."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.observation import observation_size
from tests.support.small_study import small_study
from tests.support.tiny import FRAME_SKIP
from training.algorithms.td3 import TD3
from training.commands.demonstrate import demonstrate
from training.config.run_config import Learner
from training.experience.replay import Batch

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
def make(small_robot: Robot) -> Callable[..., TD3]:
    """An algorithm on networks of two layers of 16, without target noise, always with the same weights."""

    def make(kind: type[TD3], **numbers: object) -> TD3:
        torch.manual_seed(3)
        learner = dataclasses.replace(
            Learner(hidden=(16, 16), target_noise=0.0, batch_size=_SIZE), **numbers
        )
        return kind(small_robot, learner, torch.Generator().manual_seed(0))

    return make


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """See :func:`small_study`."""
    return small_study(tmp_path / "study")
