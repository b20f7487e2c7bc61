"""Collected and stored transitions against a log of the environments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.catalogue import Capture, make_task
from cdcsr.tasks.observation import observation_size
from tests.support.tiny import FRAME_SKIP
from training.config.run_config import Learner
from training.experience.collector import Collector, exploration_noise
from training.experience.mixed_replay import MixedReplay
from training.networks.actor import Actor

NUM, STEPS, GAMMA = 5, 4, 0.9
LEARNER = Learner(
    hidden=(8, 8),
    num_envs=NUM,
    return_steps=STEPS,
    discount=GAMMA,
    capacity=700,
    noise_hold=3,
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
    env = TaskVectorEnv(NUM, robot, "mujoco", "spatter", "sparse", FRAME_SKIP, task=tried)
    actor = Actor(robot, True, (8, 8), "relu")
    collector = Collector(
        env, exploration_noise(LEARNER), LEARNER.noise_hold, np.random.default_rng(0)
    )
    replay = MixedReplay(robot, env.task, LEARNER)
    log, outcomes = _logged(env), []
    collector.start(3)
    for _ in range(230):
        for episode in collector.step(actor):
            replay.add(episode, np.random.default_rng(1))
            outcomes.append(episode.success)
    if task == "reach":  # some episodes succeed, some reach the time limit
        assert {True, False} == set(outcomes)
    paid = [one[2] for episodes in log for episode in episodes for one in episode]
    assert 0 < np.count_nonzero(paid) < len(paid)

    expected = {}
    pay = 1 if env.task.ends else 1 - GAMMA
    for episode in (episode for episodes in log for episode in episodes[:-1]):
        rewards = [pay * one[2] for one in episode]
        for t, (observation, command, *_) in enumerate(episode):
            end = min(t + STEPS, len(episode))
            stops = end == len(episode) and episode[-1][4]
            expected[np.float32(observation).tobytes()] = (
                command,
                sum(GAMMA ** (k - t) * rewards[k] for k in range(t, end)),
                0 if stops else GAMMA ** (end - t),  # time limits are bootstrapped
                episode[end - 1][3],
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


def _logged(env: TaskVectorEnv) -> list[list[list[tuple[Any, ...]]]]:
    """Log steps by environment and episode: (observation, command, reward, next, terminated)."""
    log: list[list[list[tuple[Any, ...]]]] = [[[]] for _ in range(env.num_envs)]
    step, reset = env.step, env.reset
    seen: dict[str, NDArray[Any]] = {}

    def logged_reset(**options: Any) -> Any:
        answer = reset(**options)
        seen["now"] = answer[0].copy()
        return answer

    def logged_step(commands: NDArray[Any]) -> Any:
        answer = observation, reward, terminated, truncated, info = step(commands)
        for i, episodes in enumerate(log):
            ended = terminated[i] or truncated[i]
            after = info["final_obs"][i] if ended else observation[i]
            episodes[-1].append(
                (seen["now"][i].copy(), commands[i].copy(), reward[i], after.copy(), terminated[i])
            )
            if ended:
                episodes.append([])
        seen["now"] = observation.copy()
        return answer

    env.step, env.reset = logged_step, logged_reset  # type: ignore[method-assign]
    return log


class _Still:
    """An actor whose action is zero, and an environment whose observation is zero."""

    def __init__(self, robot: Robot) -> None:
        self.num_envs, self.max_actions, self.robot = NUM, 1000, robot
        self.actions_taken = np.zeros(NUM, dtype=int)
        self.commands: list[NDArray[Any]] = []

    def act(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(observation), self.robot.num_cables)

    def to_command(self, action: torch.Tensor) -> torch.Tensor:
        return action

    def reset(self, seed: int) -> Any:
        return self._observation(), {"seed": seed}

    def step(self, command: NDArray[Any]) -> Any:
        self.commands.append(command.copy())
        self.actions_taken += 1
        nothing = np.zeros(NUM, dtype=bool)
        return self._observation(), np.zeros(NUM), nothing, nothing, {}

    def _observation(self) -> NDArray[Any]:
        return np.zeros((NUM, observation_size(self.robot)))


def test_noise_is_held_and_grows_along_the_environments(small_robot: Robot) -> None:
    still, learner = _Still(small_robot), replace(LEARNER, exploration_noise=0.1)
    collector = Collector(
        cast(TaskVectorEnv, still),
        exploration_noise(learner),
        learner.noise_hold,
        np.random.default_rng(0),
    )
    collector.start(0)
    for _ in range(900):
        assert not list(collector.step(cast(Actor, still)))
    noise = np.array(still.commands)  # (actions, environments, cables)
    for i in range(1, NUM):
        changes = np.flatnonzero((np.diff(noise[:, i], axis=0) != 0).any(axis=1)) + 1
        assert set(np.diff(changes)) == {learner.noise_hold}
        assert (changes[0] + i) % learner.noise_hold == 0
    assert noise.std(axis=(0, 2)) == pytest.approx([0, 0.05, 0.1, 0.15, 0.2], rel=0.1)


def test_noise_is_the_same_everywhere_or_climbs_a_ladder() -> None:
    learner = Learner(num_envs=5, exploration_noise=0.2)
    np.testing.assert_allclose(exploration_noise(learner), 0.2)
    ladder = exploration_noise(replace(learner, noise_ladder=True))
    np.testing.assert_allclose(ladder, [0, 0.1, 0.2, 0.3, 0.4])
