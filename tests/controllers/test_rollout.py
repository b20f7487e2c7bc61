"""One episode of each copy: what counts is up to its end, whatever the copy does after that."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.tasks.spaces import make_space
from controllers.controller import Controller
from controllers.demonstrations import Rollout, record, rollout
from controllers.jacobian import JacobianController

Array = NDArray[np.float64]


class Idle(Controller):
    name = "idle"

    def act(self, env: TaskVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
        return np.zeros((env.num_envs, 1))


class Scripted:
    """In place of an environment: what each copy's steps bring is written down. Targets move by one a step."""

    def __init__(
        self,
        distance: list[list[float]],
        success: list[str],
        terminated: list[str],
        last: list[int],
    ) -> None:
        self.num_envs = len(distance)
        self.targets = np.zeros((self.num_envs, 3))
        self._distance = np.array(distance)
        self._success, self._terminated = (
            np.array([[x == "1" for x in row] for row in y]) for y in (success, terminated)
        )
        self._last, self._taken = np.array(last), 0

    def step(self, action: Array) -> tuple[Any, ...]:
        k = self._taken
        self._taken += 1
        self.targets += 1.0
        info = {"distance": self._distance[:, k], "is_success": self._success[:, k]}
        observation = np.full((self.num_envs, 1), float(self._taken))
        return (
            observation,
            self._success[:, k] * 1.0,
            self._terminated[:, k],
            self._last <= self._taken,
            info,
        )


@pytest.fixture
def result() -> Rollout:
    """Five steps. The first copy succeeds at the second; the next runs out of time at the third, and would have
    succeeded at the fourth; the third is on its target for a moment and not in the end; the last goes on throughout."""
    env = Scripted(
        [
            [0.5, 0.02, 0.01, 0.3, 0.4],
            [0.5, 0.2, 0.3, 0.01, 0.01],
            [0.4, 0.02, 0.3, 0.3, 0.1],
            [0.9, 0.8, 0.7, 0.6, 0.02],
        ],
        ["01000", "00011", "01000", "00001"],
        ["01000", "00011", "00000", "00001"],
        [9, 3, 4, 9],
    )
    return rollout(Idle(), cast(TaskVectorEnv, env), np.zeros((4, 1)))


def test_success_is_as_an_episode_ends(result: Rollout) -> None:
    assert result.success.tolist() == [True, False, False, True]
    assert result.terminated.tolist() == [True, False, False, True]
    assert result.length.tolist() == [2, 3, 4, 5]


def test_distances_are_up_to_the_end(result: Rollout) -> None:
    assert result.distance.tolist() == [0.02, 0.3, 0.3, 0.02]
    assert result.nearest.tolist() == [0.02, 0.2, 0.02, 0.02]


def test_an_episode_is_cut_to_its_length_and_its_target_is_where_it_was_at_first(
    result: Rollout,
) -> None:
    first, last = result.successes()
    assert first.observations[:, 0].tolist() == [0, 1, 2]
    assert (len(first.actions), first.rewards.tolist()) == (2, [0, 1])
    assert (last.length, last.rewards.tolist()) == (5, [0, 0, 0, 0, 1])
    assert first.target.tolist() == last.target.tolist() == [0, 0, 0]


def test_each_batch_of_a_recording_has_targets_of_its_own() -> None:
    """Of one stream, drawn here once more."""
    env = TaskVectorEnv(2, frame_skip=5, autoreset_mode="Disabled")
    episodes, failed = record(JacobianController(env.robot), env, num=5, seed=3)
    env.close()
    assert failed == 0
    rng, space = np.random.default_rng(3), make_space("anchor", env.robot)
    expected = np.concatenate([space.sample(rng, 2) for _ in range(3)])[:5]
    np.testing.assert_array_equal([episode.target for episode in episodes], expected)
