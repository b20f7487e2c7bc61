"""Behaviour cloning learns what it is shown."""

from __future__ import annotations

import pytest
import torch

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import observation_size
from training.algorithms.bc import BehaviourCloning, imitate
from training.config.learner import Cloning


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
