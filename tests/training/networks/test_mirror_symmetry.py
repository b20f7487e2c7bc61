"""Mirror symmetry: mirrored situations give mirrored actions, and share what is learned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from cdcsr.envs.gym_env import Info, TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import principal_engines
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import TARGET, observation_size
from cdcsr.tasks.symmetry import images
from controllers.rollout import rollout
from tests.support.tiny import tiny_changes
from training.algorithms.batd3 import BATD3Numbers
from training.algorithms.bc import BehaviourCloning
from training.experience.collector import Collector, FinishedEpisode
from training.experience.mixed_replay import MixedReplay
from training.networks.actor import Actor
from training.networks.mirror_symmetry import MirrorSymmetry
from training.policy import Policy, find_policy, load_policy
from training.run.train_options import Train
from training.run.trainer import train

_LEARNER = BATD3Numbers(hidden=(16,), symmetry=True, batch_size=8, capacity=100, bc_updates=50)


@pytest.fixture(params=["paper", "three-cable"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def _observations(robot: Robot, count: int = 20) -> NDArray[np.float64]:
    return np.random.default_rng(0).normal(size=(count, observation_size(robot)))


def test_a_mirrored_observation_gives_the_mirrored_action(robot: Robot) -> None:
    torch.manual_seed(0)
    actor = Actor(robot, True, (16,), "relu", mirror_symmetry=True).double()
    plain = Actor(robot, True, (16,), "relu").double()
    observations = _observations(robot)

    def does(actor: Actor, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        with torch.no_grad():
            return actor.act(torch.from_numpy(observations)).numpy()

    for image in images(robot)[1:]:
        seen = image.observation(observations)
        np.testing.assert_allclose(
            does(actor, seen), image.command(does(actor, observations)), atol=1e-12
        )
        assert np.abs(does(plain, seen) - image.command(does(plain, observations))).max() > 0.01


def test_all_targets_are_mirrored_into_one_quarter() -> None:
    robot = load_robot("paper")
    observations = torch.from_numpy(_observations(robot))
    canonical = MirrorSymmetry(robot)(observations).observation
    target = canonical[:, TARGET]
    torch.testing.assert_close(
        target, torch.stack([*observations[:, TARGET][:, :2].abs().T, target[:, 2]], 1)
    )
    again = MirrorSymmetry(robot)(canonical).observation
    torch.testing.assert_close(again, canonical, rtol=0, atol=0)


def test_all_images_of_an_episode_are_stored_alike(robot: Robot) -> None:
    """This holds for a target that moves during the episode, too."""
    length, rng = 30, np.random.default_rng(1)
    observations, actions = (
        _observations(robot, length + 1),
        rng.uniform(-1, 1, (length, robot.num_cables)),
    )
    stored = []
    for image in images(robot):
        clone = BehaviourCloning(robot, _LEARNER, torch.Generator())
        clone.actor.load_state_dict(_clone(robot).actor.state_dict())
        replay = MixedReplay(robot, make_task("reach"), _LEARNER, clone.actions)
        episode = image.observation(observations), image.command(actions), np.eye(length)[-1]
        replay.prefill([FinishedEpisode(*episode, True, True)])
        stored.append({name: rows[:length] for name, rows in replay.buffers["replay"].rows.items()})
    for other in stored[1:]:
        for name, rows in other.items():
            np.testing.assert_allclose(rows, stored[0][name], atol=1e-6, err_msg=name)
    assert np.abs(stored[0]["action"] - actions).max() > 0.1


def _clone(robot: Robot) -> BehaviourCloning:
    torch.manual_seed(0)
    return BehaviourCloning(robot, _LEARNER, torch.Generator().manual_seed(0))


class _NearPlane(TaskVectorEnv):
    """Two environments whose first targets are near a mirror plane."""

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[NDArray[np.float64], Info]:
        targets = np.array([[0.01, 0.004, 2.5], [0.3, 0.02, 2.4]])
        return super().reset(seed=seed, options={"targets": targets})


def test_collected_actions_are_the_actors_at_the_canonical_image() -> None:
    """Each row is mirrored by itself: these targets drift across a mirror plane."""
    robot = load_robot("paper")
    torch.manual_seed(0)
    actor = Actor(robot, True, (16,), "relu", mirror_symmetry=True)
    learner = _LEARNER.changed(capacity=2000)
    env = _NearPlane(2, robot, frame_skip=5, task="capture-drift")
    collector = Collector(env, 0.0, 1, np.random.default_rng(0))
    collector.start(seed=0)
    replay, crossed = MixedReplay(robot, env.task, learner), 0
    for _ in range(100):
        for episode in collector.step(actor):
            crossed += np.ptp(np.sign(episode.observations[:, TARGET][:, :2]), axis=0).any()
            replay.add(episode, np.random.default_rng(0))
    env.close()
    assert crossed
    rows = replay.buffers["replay"]
    stored = {name: torch.from_numpy(values[: rows.size]) for name, values in rows.rows.items()}
    taken = stored["successor"] >= 0
    with torch.no_grad():
        expected = actor(actor.encoder(stored["observation"]))
    assert (stored["observation"][:, TARGET][:, :2] >= 0).all()
    torch.testing.assert_close(stored["action"][taken], expected[taken], rtol=0, atol=1e-5)


@pytest.mark.parametrize("averaged", [True, False])
def test_a_trained_policy_and_its_clone_are_symmetric(tmp_path: Path, averaged: bool) -> None:
    out = tmp_path / "run"
    train(
        Train(
            out=out,
            frame_skip=5,
            num_demonstrations=1,
            evaluate_every=0,
            evaluate_episodes=1,
            updates=40,
            changes=tiny_changes("batd3", symmetry=True, averaged_policy=averaged),
        )
    )
    robot = load_robot("paper")
    observations = _observations(robot)
    for folder in (out, out / "clone"):
        actor = load_policy(folder).actor
        image = images(robot)[1]
        with torch.no_grad():
            one, other = (
                actor.command(torch.from_numpy(rows).float()).numpy()
                for rows in (observations, image.observation(observations))
            )
        np.testing.assert_allclose(other, image.command(one), atol=1e-5)


def test_a_robot_without_mirror_image_is_refused(tmp_path: Path) -> None:
    text = load_robot("planar-single").to_toml().replace("90.0", "80.0")
    path = tmp_path / "odd.toml"
    path.write_text(text)
    assert len(images(load_robot(str(path)))) == 1
    with pytest.raises(CdcsrError, match="symmetry must be off"):
        train(Train(out=tmp_path / "run", robot=str(path), changes=(("symmetry", True),)))
    assert not (tmp_path / "run").exists()


def test_targets_are_mirrored_to_the_workspaces_side() -> None:
    data = load_robot("paper").model_dump()
    data["workspace"]["center"] = (-0.2, 0.1, 2.45)
    observations = torch.from_numpy(_observations(load_robot("paper")))
    targets = MirrorSymmetry(Robot.model_validate(data))(observations).observation[:, TARGET]
    assert (targets[:, 0] <= 0).all()
    assert (targets[:, 1] >= 0).all()


def test_a_clone_learns_the_same_from_every_image(robot: Robot) -> None:
    observations = torch.from_numpy(_observations(robot)).float()
    commands = -torch.rand(20, robot.num_cables, generator=torch.Generator().manual_seed(0))
    done = []
    for image in images(robot):
        clone = _clone(robot)
        seen, shown = (
            torch.from_numpy(rows).float()
            for rows in (image.observation(observations.numpy()), image.command(commands.numpy()))
        )
        clone.fit(seen, shown, lambda *_: None)
        done.append(clone.actor.command(observations))
    for other in done[1:]:
        torch.testing.assert_close(other, done[0], rtol=1e-4, atol=1e-5)


def test_a_saved_policy_keeps_its_symmetry(robot: Robot, tmp_path: Path) -> None:
    observation = torch.from_numpy(_observations(robot)).float()
    for symmetry in (True, False):
        torch.manual_seed(0)
        actor, folder = Actor(robot, True, (16,), "relu", symmetry), tmp_path / str(symmetry)
        card = {"name": "test", "frame_skip": 1, "space": "anchor", "backend": "mujoco"}
        Policy(actor, robot, np.ones((2, 3)), card).save(folder)
        read = load_policy(folder)
        torch.testing.assert_close(
            read.actor.command(observation), actor.command(observation), rtol=0, atol=0
        )


@pytest.mark.parametrize("name", ["clasp-workspace-mujoco", "clasp-anchor-mujoco"])
@pytest.mark.parametrize("engine", principal_engines())
def test_images_of_a_target_are_reached_along_images_of_one_path(engine: str, name: str) -> None:
    policy = find_policy(name)
    known = images(policy.robot)
    target = np.array([0.12, 0.21, 2.4])
    targets = np.array([target * image.signs[TARGET] for image in known])
    env = TaskVectorEnv(len(known), policy.robot, engine, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": targets})
    outcome = rollout(policy, env, observation)
    env.close()
    lengths = [len(episode.actions) for episode in outcome.successes()]
    assert lengths == [lengths[0]] * 4
    observed = [episode.observations for episode in outcome.successes()]
    for image, seen in zip(known, observed, strict=True):
        # The error of single precision grows through feedback.
        np.testing.assert_allclose(seen, image.observation(observed[0]), atol=1e-3)


def test_off_by_default() -> None:
    assert BATD3Numbers().symmetry is False
