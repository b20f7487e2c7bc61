"""Collected and stored transitions against a log of the environments."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike, NDArray

from cdcsr.envs.gym_env import Info, TaskVectorEnv
from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.catalogue import Capture, make_task
from cdcsr.tasks.observation import TARGET
from tests.support.tiny import FRAME_SKIP
from training.config.learner import Practising
from training.experience.collector import Collector, exploration_noise
from training.experience.mixed_replay import MixedReplay
from training.networks.actor import Actor

Array, Mask = NDArray[np.float64], NDArray[np.bool_]

NUM, STEPS, GAMMA = 5, 4, 0.9
LEARNER = Practising(
    capacity=700,
    noise_hold=3,
    hidden=(8, 8),
    num_envs=NUM,
    return_steps=STEPS,
    discount=GAMMA,
    exploration_noise=0.5,
    noise_ladder=True,
    batch_size=16,
)


@pytest.mark.parametrize(
    ("task", "threshold"), [("reach", 0.6), ("capture", 1.0), ("follow-random", 0.5)]
)
def test_stored_transitions_are_those_of_the_environment(task: str, threshold: float) -> None:
    torch.manual_seed(0)
    robot = load_robot("paper")
    tried = make_task(task, threshold=threshold)
    if isinstance(tried, Capture):  # easy enough for random actions
        tried = replace(tried, speed=50.0, dwell=0.05)
    env = _LoggedEnv(NUM, robot, "mujoco", "spatter", "sparse", FRAME_SKIP, task=tried)
    actor = Actor(robot, True, (8, 8), "relu")
    collector = Collector(
        env, exploration_noise(LEARNER), LEARNER.noise_hold, np.random.default_rng(0)
    )
    replay = MixedReplay(robot, env.task, LEARNER)
    outcomes = []
    collector.start(3)
    for _ in range(230):
        for episode in collector.step(actor):
            replay.add(episode, np.random.default_rng(1))
            outcomes.append(episode.success)
    if task == "reach":  # some episodes succeed, some reach the time limit
        assert {True, False} == set(outcomes)
    paid = [one.reward for episodes in env.log for episode in episodes for one in episode]
    assert 0 < np.count_nonzero(paid) < len(paid)

    expected = {}
    pay = 1 if env.task.ends else 1 - GAMMA
    for episode in (episode for episodes in env.log for episode in episodes[:-1]):
        rewards = [pay * one.reward for one in episode]
        for t, one in enumerate(episode):
            end = min(t + STEPS, len(episode))
            stops = end == len(episode) and episode[-1].terminated
            expected[np.float32(one.observation).tobytes()] = (
                one.command,
                sum(GAMMA ** (k - t) * rewards[k] for k in range(t, end)),
                0 if stops else GAMMA ** (end - t),  # time limits are bootstrapped
                episode[end - 1].following,
                sum(GAMMA ** (k - t) * rewards[k] for k in range(t, len(episode))),
            )
    rows, found = replay.buffers["replay"], 0
    for row in np.flatnonzero(rows.rows["successor"][: rows.size] >= 0):
        stored = {name: values[row] for name, values in rows.rows.items()}
        command, reward, discount, following, outcome = expected[stored["observation"].tobytes()]
        np.testing.assert_allclose(
            actor.from_command(torch.as_tensor(command)).numpy(), stored["action"], atol=1e-5
        )
        assert (stored["reward"], stored["outcome"]) == pytest.approx((reward, outcome), abs=1e-5)
        assert stored["discount"] == pytest.approx(discount, abs=1e-5)
        np.testing.assert_array_equal(
            np.float32(following), rows.rows["observation"][stored["successor"]]
        )
        found += 1
    assert found > 250


class _Step(NamedTuple):
    """One action of one environment."""

    observation: Array
    command: Array
    reward: float
    following: Array
    terminated: bool


class _LoggedEnv(TaskVectorEnv):
    """Environments that log every step by environment and episode."""

    log: list[list[list[_Step]]]

    def reset(self, **options: Any) -> tuple[Array, Info]:
        self._seen, info = super().reset(**options)
        self.log = [[[]] for _ in range(self.num_envs)]
        return self._seen.copy(), info

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Mask, Mask, Info]:
        answer = observation, reward, terminated, truncated, info = super().step(actions)
        for i, episodes in enumerate(self.log):
            ended = terminated[i] or truncated[i]
            after = info["final_obs"][i] if ended else observation[i]
            command = np.array(actions)[i]
            done = _Step(self._seen[i], command, reward[i], after.copy(), terminated[i])
            episodes[-1].append(done)
            if ended:
                episodes.append([])
        self._seen = observation.copy()
        return answer


def test_noise_is_held_and_grows_along_the_environments(paper: Robot) -> None:
    actor = Actor(paper, False, (4,), "relu")
    for parameter in actor.parameters():
        parameter.data.zero_()
    env = _LoggedEnv(NUM, paper)
    scale = exploration_noise(LEARNER.changed(exploration_noise=0.1))
    collector = Collector(env, scale, LEARNER.noise_hold, np.random.default_rng(0))
    collector.start(0)
    for _ in range(300):
        list(collector.step(actor))
    env.close()
    # Shape (environments, actions, cables).
    commands = np.array([[one.command for one in chain(*episodes)] for episodes in env.log])
    noise = actor.from_command(torch.from_numpy(commands)).numpy()
    for i in range(1, NUM):
        changes = np.flatnonzero((np.diff(noise[i], axis=0) != 0).any(axis=1)) + 1
        assert set(np.diff(changes)) == {LEARNER.noise_hold}
        assert (changes[0] + i) % LEARNER.noise_hold == 0
    assert noise.std(axis=(1, 2)) == pytest.approx([0, 0.05, 0.1, 0.15, 0.2], rel=0.1, abs=1e-6)


def test_noise_is_the_same_everywhere_or_climbs_a_ladder() -> None:
    learner = Practising(num_envs=5, exploration_noise=0.2)
    np.testing.assert_allclose(exploration_noise(learner), 0.2)
    ladder = exploration_noise(learner.changed(noise_ladder=True))
    np.testing.assert_allclose(ladder, [0, 0.1, 0.2, 0.3, 0.4])


def test_episodes_carry_the_drift_that_their_targets_have(paper: Robot) -> None:
    """Each its own, also after others began in the same environment."""
    options: dict[str, Any] = {"start": "moving", "frame_skip": FRAME_SKIP, "max_steps": 60}
    env = TaskVectorEnv(3, paper, threshold=1e-6, **options)
    collector = Collector(env, 0.5, 1, np.random.default_rng(0))
    collector.start(2)
    actor, drifts = Actor(paper, True, (8, 8), "relu"), set()
    for episode in (one for _ in range(19) for one in collector.step(actor)):
        assert episode.drift is not None
        moved = np.diff(episode.observations[:, TARGET], axis=0)
        drift = episode.drift * env.task.period
        np.testing.assert_allclose(moved, np.broadcast_to(drift, moved.shape), atol=1e-12)
        drifts.add(tuple(episode.drift))
    env.close()
    assert len(drifts) == 9
