"""Steps the environments with the policy and held exploration noise, and hands over episodes as they end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.tasks.observation import observation_size
from training.config.run_config import Learner
from training.networks.actor_critic import Actor

Array = NDArray[np.float64]

_ENVIRONMENT = "environment."
"""Begins the names of the environment's arrays among the collector's."""


@dataclass(frozen=True)
class FinishedEpisode:
    """One episode of T actions as it came from the environment."""

    observations: Array
    """(T + 1, 23 + C)."""
    actions: Array
    """(T, C), in [-1, 1]."""
    rewards: Array
    """(T,)."""
    success: bool
    terminated: bool
    """It ended by success; otherwise by running out of time, which may be a success where a target is followed."""


def exploration_noise(learner: Learner) -> Array:
    """Standard deviation of the noise in each environment, shape (num_envs,), on actions in [-1, 1]."""
    if not learner.noise_ladder:
        return np.full(learner.num_envs, learner.exploration_noise)
    return np.linspace(0, 2 * learner.exploration_noise, learner.num_envs)


class Collector:
    """Runs a batch of environments, one action each at a time.

    White noise at the control rate does nothing to this plant, which filters it out; so each draw of noise is
    held for several actions. Copies change theirs at different times.

    Args:
        env: with autoreset SAME_STEP.
        noise: standard deviation, on actions in [-1, 1]; a number, or one for each environment.
        hold: actions for which a draw is held.
        rng: draws the noise.
    """

    def __init__(
        self, env: TaskVectorEnv, noise: float | Array, hold: int, rng: np.random.Generator
    ) -> None:
        self.env, self._hold, self._rng = env, hold, rng
        self._scale = np.broadcast_to(noise, env.num_envs)[:, None]
        num, limit, cables = env.num_envs, env.max_actions, env.robot.num_cables
        size = observation_size(env.robot)
        self._observations = np.zeros((num, limit + 1, size))
        self._actions = np.zeros((num, limit, cables))
        self._rewards = np.zeros((num, limit))
        self._noise = np.zeros((num, cables))
        self._count = 0
        self._observation = np.zeros((num, size))

    def start(self, seed: int) -> None:
        """Begin the first episodes."""
        self._observation, _ = self.env.reset(seed=seed)

    def step(self, actor: Actor) -> Iterator[FinishedEpisode]:
        """One action in every environment; yields the episodes that ended with it."""
        env, everyone = self.env, np.arange(self.env.num_envs)
        with torch.no_grad():
            action = (
                actor.act(torch.as_tensor(self._observation, dtype=torch.float32))
                .numpy()
                .astype(np.float64)
            )
        fresh = (everyone + self._count) % self._hold == 0
        self._noise[fresh] = self._scale[fresh] * self._rng.normal(
            size=(int(fresh.sum()), action.shape[1])
        )
        self._count += 1
        action = np.clip(action + self._noise, -1, 1)
        at = env.actions_taken.copy()
        self._observations[everyone, at] = self._observation
        self._actions[everyone, at] = action
        command = actor.to_command(torch.as_tensor(action)).numpy()
        self._observation, reward, terminated, truncated, info = env.step(command)
        self._rewards[everyone, at] = reward
        for i in np.flatnonzero(terminated | truncated):
            length = at[i] + 1
            self._observations[i, length] = info["final_obs"][i]
            yield FinishedEpisode(
                self._observations[i, : length + 1],
                self._actions[i, :length],
                self._rewards[i, :length],
                bool(info["final_info"]["is_success"][i]),
                bool(terminated[i]),
            )

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """All that is needed to go on from here, but for the generator of the noise."""
        own = {
            "observations": self._observations,
            "actions": self._actions,
            "rewards": self._rewards,
            "noise": self._noise,
            "count": np.array(self._count),
            "observation": self._observation,
        }
        return own | {f"{_ENVIRONMENT}{name}": rows for name, rows in self.env.get_state().items()}

    def load_state_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Go on from arrays made by :meth:`state_arrays`."""
        environment = {
            k.removeprefix(_ENVIRONMENT): v for k, v in arrays.items() if k.startswith(_ENVIRONMENT)
        }
        self.env.set_state(environment)
        self._observations[:], self._actions[:] = arrays["observations"], arrays["actions"]
        self._rewards[:], self._noise[:] = arrays["rewards"], arrays["noise"]
        self._count = int(arrays["count"])
        self._observation = arrays["observation"].copy()
