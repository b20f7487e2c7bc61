"""Folding: one action for all images of a situation, and a learner that sees only one part of the space."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from cdcsr.envs import ReachVectorEnv
from cdcsr.observation import TARGET, observation_size
from cdcsr.robot import Robot, load_robot
from cdcsr.symmetry import images
from cdcsr.tasks import make_task
from controllers.demonstrations import rollout
from training.algorithms.bc import BehaviourCloning
from training.collector import FinishedEpisode
from training.config import Learner
from training.folding import Folding
from training.memory import Memory
from training.networks import Actor
from training.policy import Policy, find_policy, load_policy

_LEARNER = Learner(hidden=(16,), symmetry=True, batch_size=8, capacity=100, bc_updates=50)


@pytest.fixture(params=["paper", "three-cable"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def _observations(robot: Robot, count: int = 20) -> NDArray[np.float64]:
    return np.random.default_rng(0).normal(size=(count, observation_size(robot)))


def test_a_policy_does_the_image_of_what_it_does(robot: Robot) -> None:
    torch.manual_seed(0)
    actor = Actor(robot, True, (16,), "relu", symmetry=True).double()
    plain = Actor(robot, True, (16,), "relu").double()
    observations = _observations(robot)

    def does(actor: Actor, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        with torch.no_grad():
            return actor.act(torch.from_numpy(observations)).numpy()

    for image in images(robot)[1:]:
        seen = image.observation(observations)
        np.testing.assert_allclose(does(actor, seen), image.command(does(actor, observations)), atol=1e-12)
        assert np.abs(does(plain, seen) - image.command(does(plain, observations))).max() > 0.01


def test_all_targets_are_folded_into_one_part() -> None:
    robot = load_robot("paper")
    observations = torch.from_numpy(_observations(robot))
    folded = Folding(robot)(observations).observation
    target = folded[:, TARGET]
    torch.testing.assert_close(target, torch.stack([*observations[:, TARGET][:, :2].abs().T, target[:, 2]], 1))
    torch.testing.assert_close(Folding(robot)(folded).observation, folded, rtol=0, atol=0)


def test_rows_are_stored_folded(robot: Robot) -> None:
    """Whichever image of an episode is collected, the same is stored, also where the target goes elsewhere midway."""
    length, rng = 30, np.random.default_rng(1)
    observations, actions = _observations(robot, length + 1), rng.uniform(-1, 1, (length, robot.num_cables))
    stored = []
    for image in images(robot):
        clone = BehaviourCloning(robot, _LEARNER, torch.Generator())
        clone.actor.load_state_dict(_clone(robot).actor.state_dict())
        memory = Memory(robot, _LEARNER, clone.actions, make_task("reach"))
        episode = image.observation(observations), image.command(actions), np.eye(length)[-1]
        memory.begin([FinishedEpisode(*episode, True, True)])
        stored.append({name: rows[:length] for name, rows in memory.replays["replay"].rows.items()})
    for other in stored[1:]:
        for name, rows in other.items():
            np.testing.assert_allclose(rows, stored[0][name], atol=1e-6, err_msg=name)
    assert np.abs(stored[0]["action"] - actions).max() > 0.1


def _clone(robot: Robot) -> BehaviourCloning:
    torch.manual_seed(0)
    return BehaviourCloning(robot, _LEARNER, torch.Generator().manual_seed(0))


def test_a_clone_learns_the_same_from_every_image(robot: Robot) -> None:
    observations = torch.from_numpy(_observations(robot)).float()
    commands = -torch.rand(20, robot.num_cables, generator=torch.Generator().manual_seed(0))
    done = []
    for image in images(robot):
        clone = _clone(robot)
        seen, shown = (torch.from_numpy(rows).float() for rows in (
            image.observation(observations.numpy()), image.command(commands.numpy())
        ))  # fmt: skip
        clone.fit(seen, shown, lambda *_: None)
        done.append(clone.actor.command(observations))
    for other in done[1:]:
        torch.testing.assert_close(other, done[0], rtol=1e-4, atol=1e-5)


def test_a_policy_keeps_that_it_folds(robot: Robot, tmp_path: Path) -> None:
    observation = torch.from_numpy(_observations(robot)).float()
    for symmetry in (True, False):
        torch.manual_seed(0)
        actor, folder = Actor(robot, True, (16,), "relu", symmetry), tmp_path / str(symmetry)
        Policy(actor, robot, np.ones((2, 3)), {"name": "test", "frame_skip": 1}).save(folder)
        read = load_policy(folder)
        torch.testing.assert_close(read.actor.command(observation), actor.command(observation), rtol=0, atol=0)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_images_of_a_target_are_reached_along_images_of_one_path(engine: str) -> None:
    policy = find_policy("clasp-workspace-mujoco")
    known = images(policy.robot)
    target = np.array([0.12, 0.21, 2.4])
    targets = np.array([target * image.signs[TARGET] for image in known])
    env = ReachVectorEnv(len(known), policy.robot, engine, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": targets})
    outcome = rollout(policy, env, observation)
    env.close()
    lengths = [len(episode.actions) for episode in outcome.successes()]
    assert lengths == [lengths[0]] * 4
    tips = [episode.observations for episode in outcome.successes()]
    for image, seen in zip(known, tips, strict=True):
        np.testing.assert_allclose(seen, image.observation(tips[0]), atol=1e-3)  # single precision, fed back


def test_off_by_default() -> None:
    assert dataclasses.asdict(Learner())["symmetry"] is False
