"""Collect episodes: step the environments with the actor and exploration noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.tasks.observation import observation_size
from training.config.learner import Practising
from training.networks.actor import Actor

Array = NDArray[np.float64]

_ENVIRONMENT = "environment."
"""Prefix of the environment's arrays among the collector's."""


@dataclass(frozen=True)
class FinishedEpisode:
    """One episode of T actions as the environment gave it."""

    observations: Array
    """(T + 1, observation size)."""
    actions: Array
    """(T, C), in [-1, 1]."""
    rewards: Array
    """(T,)."""
    success: bool
    terminated: bool
    """The episode ended by success. Otherwise it ended at the time limit, which can be a success
    too where a target is followed."""
    drift: Array | None = None
    """The velocity that target and robot shared from the start, shape (3,), in [m/s]; None: none.
    """


def exploration_noise(learner: Practising) -> Array:
    """Return the standard deviation of the noise on actions in [-1, 1], shape (num_envs,)."""
    if not learner.noise_ladder:
        return np.full(learner.num_envs, learner.exploration_noise)
    return np.linspace(0, 2 * learner.exploration_noise, learner.num_envs)


class Collector:
    """Run a batch of environments, one action each at a time.

    The robot filters out white noise at the control rate, so each draw of noise is held for
    several actions. The environments draw at different times. An episode that diverges is dropped
    and counted; its environment begins anew.

    Args:
        env: with autoreset mode SAME_STEP.
        noise: standard deviation on actions in [-1, 1]: a number, or one for each environment.
        hold: number of actions for which a draw is held.
        rng: draws the noise.

    Attributes:
        diverged: how many episodes were dropped.
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
        self._count = self.diverged = 0
        self._observation = np.zeros((num, size))

    def start(self, seed: int) -> None:
        """Begin the first episodes."""
        self._observation, _ = self.env.reset(seed=seed)

    def step(self, actor: Actor) -> Iterator[FinishedEpisode]:
        """Take one action in every environment; yield the episodes that it ended."""
        env, everyone = self.env, np.arange(self.env.num_envs)
        with torch.no_grad():
            observed = torch.as_tensor(self._observation, dtype=torch.float32)
            action = actor.act(observed).numpy().astype(np.float64)
        fresh = (everyone + self._count) % self._hold == 0
        drawn = self._rng.normal(size=(int(fresh.sum()), action.shape[1]))
        self._noise[fresh] = self._scale[fresh] * drawn
        self._count += 1
        action = np.clip(action + self._noise, -1, 1)
        at, drift = env.actions_taken.copy(), env.drift.copy()
        self._observations[everyone, at] = self._observation
        self._actions[everyone, at] = action
        command = actor.to_command(torch.as_tensor(action)).numpy()
        self._observation, reward, terminated, truncated, info = env.step(command)
        self._rewards[everyone, at] = reward
        lost = info.get("diverged", np.zeros(env.num_envs, dtype=bool))
        self.diverged += int(lost.sum())
        for i in np.flatnonzero((terminated | truncated) & ~lost):
            length = at[i] + 1
            self._observations[i, length] = info["final_obs"][i]
            yield FinishedEpisode(
                self._observations[i, : length + 1],
                self._actions[i, :length],
                self._rewards[i, :length],
                bool(info["final_info"]["is_success"][i]),
                bool(terminated[i]),
                drift[i],
            )

    def state_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return everything needed to continue, except the state of the noise generator."""
        own = {
            "observations": self._observations,
            "actions": self._actions,
            "rewards": self._rewards,
            "noise": self._noise,
            "count": np.array(self._count),
            "diverged": np.array(self.diverged),
            "observation": self._observation,
        }
        return own | {f"{_ENVIRONMENT}{name}": rows for name, rows in self.env.get_state().items()}

    def load_state_arrays(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Continue from the arrays that :meth:`state_arrays` returned."""
        environment = {
            k.removeprefix(_ENVIRONMENT): v for k, v in arrays.items() if k.startswith(_ENVIRONMENT)
        }
        self.env.set_state(environment)
        self._observations[:], self._actions[:] = arrays["observations"], arrays["actions"]
        self._rewards[:], self._noise[:] = arrays["rewards"], arrays["noise"]
        self._count = int(arrays["count"])
        self.diverged = int(arrays.get("diverged", 0))  # older runs have no such number
        self._observation = arrays["observation"].astype(np.float64)
