"""Demonstrations: record a controller into a Minari dataset, and read one back."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.tasks.observation import TARGET
from controllers.controller import Controller

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Episode:
    """One successful episode of T actions."""

    observations: Array
    """(T + 1, 23 + C)."""
    actions: Array
    """(T, C) servo set-points in [m]."""
    target: Array
    """(3,) where it was in the beginning, world frame, in [m]."""
    rewards: Array
    """(T,)."""
    terminated: bool
    """It ended by success, and not by running out of time, as an episode of following does."""

    @property
    def length(self) -> int:
        return len(self.actions)


def digest(episodes: Sequence[Episode]) -> str:
    """Of what happens in them: equal only for equal episodes."""
    data = hashlib.sha256()
    for episode in episodes:
        for values in (episode.observations, episode.actions, episode.rewards):
            data.update(np.ascontiguousarray(values).tobytes())
    return data.hexdigest()[:16]


@dataclass(frozen=True)
class Rollout:
    """One episode of each of N copies, run side by side; rows go on after an episode's end."""

    observations: Array
    """(N, steps + 1, 23 + C)."""
    actions: Array
    """(N, steps, C) servo set-points in [m]."""
    targets: Array
    """(N, 3) where they were in the beginning, world frame, in [m]."""
    rewards: Array
    """(N, steps)."""
    success: NDArray[np.bool_]
    """(N,)."""
    terminated: NDArray[np.bool_]
    """(N,) ended by success, and not by running out of time."""
    length: NDArray[np.int64]
    """(N,) actions until the end of each episode."""
    distance: Array
    """(N,) from tip to target at that end, in [m]."""
    nearest: Array
    """(N,) the least it was before or at that end, in [m]; of the plant, whatever was observed."""

    def successes(self) -> list[Episode]:
        """The successful episodes, each cut to its length."""
        return [self._episode(i, n) for i, n in enumerate(self.length) if self.success[i]]

    def _episode(self, i: int, length: int) -> Episode:
        return Episode(
            self.observations[i, : length + 1],
            self.actions[i, :length],
            self.targets[i],
            self.rewards[i, :length],
            bool(self.terminated[i]),
        )


def record(
    controller: Controller, env: TaskVectorEnv, num: int, seed: int
) -> tuple[list[Episode], int]:
    """Record successful episodes of a controller; one that misses its target is drawn anew.

    Args:
        controller: who demonstrates.
        env: robots with autoreset disabled, as many as run side by side.
        num: how many successful episodes.
        seed: of the targets.

    Returns:
        The episodes in the order of their targets, and how many failed along the way.

    Raises:
        CdcsrError: fewer than one in ten of the episodes succeeds.
    """
    episodes: list[Episode] = []
    failed = 0
    observation, _ = env.reset(seed=seed)
    while True:
        batch = rollout(controller, env, observation)
        failed += int((~batch.success).sum())
        episodes += batch.successes()
        if len(episodes) >= num:
            return episodes[:num], failed
        if failed > 10 * max(num, env.num_envs):
            raise CdcsrError(
                f"The controller {controller.name!r} reached {len(episodes)} of {len(episodes) + failed} targets "
                f"in the space {env.space.name!r}; move or shrink the robot's workspace."
            )
        observation, _ = env.reset()


def rollout(controller: Controller, env: TaskVectorEnv, observation: Array) -> Rollout:
    """One episode per copy, from the observation of a reset."""
    num = env.num_envs
    active = np.ones(num, dtype=bool)
    success, ended = np.zeros((2, num), dtype=bool)
    length = np.zeros(num, dtype=np.int64)
    distance, nearest = np.full((2, num), np.inf)
    observations, actions, rewards, targets = [observation], [], [], env.targets.copy()
    while active.any():
        action = controller.act(env, observation, active)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        length[active] += 1
        distance[active] = info["distance"][active]
        nearest[active] = np.minimum(nearest, info["distance"])[active]
        success[active] = info["is_success"][active]
        ended |= active & terminated
        active &= ~(terminated | truncated)
    return Rollout(
        np.stack(observations, axis=1),
        np.stack(actions, axis=1),
        targets,
        np.stack(rewards, axis=1),
        success,
        ended,
        length,
        distance,
        nearest,
    )


def save(
    folder: Path, episodes: list[Episode], env: TaskVectorEnv, controller: str, dataset_id: str
) -> None:
    """Write a Minari dataset (hdf5) into an existing, empty folder."""
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    spec = copy.deepcopy(gymnasium.spec(f"cdcsr/{env.task.kind.capitalize()}-v0"))
    spec.kwargs = {
        "task": env.task.name,
        "robot": env.robot.name,
        "backend": env.backend,
        "space": env.space.name,
        "frame_skip": env.frame_skip,
    }
    storage = MinariStorage.new(
        folder / "data", env.single_observation_space, env.single_action_space, spec
    )
    storage.update_metadata(
        {
            "dataset_id": dataset_id,
            "minari_version": minari.__version__,
            "algorithm_name": controller,
            "description": f"Successful episodes of {env.task.name!r} by a cable-driven continuum space robot.",
            "robot": env.robot.name,
            "robot_fingerprint": env.robot.fingerprint,
            "task": env.task.name,
            "backend": env.backend,
            "space": env.space.name,
            "frame_skip": env.frame_skip,
        }
    )
    buffers = []
    for i, episode in enumerate(episodes):
        last = np.arange(1, episode.length + 1) == episode.length
        buffers.append(
            EpisodeBuffer(
                id=i,
                observations=list(episode.observations),
                actions=list(episode.actions),
                rewards=list(episode.rewards),
                terminations=list(last & episode.terminated),
                truncations=list(last & (not episode.terminated)),
            )
        )
    storage.update_episodes(buffers)


def load(
    folder: Path, robot_fingerprint: str, frame_skip: int = 1, task: str | None = None
) -> list[Episode]:
    """Read the episodes of a dataset written by :func:`save`; of any task, if none is given.

    Raises:
        CdcsrError: it is no such dataset, or of another robot, frame skip or task.
    """
    from minari import MinariDataset

    try:
        dataset = MinariDataset(folder / "data")
        metadata = dataset.storage.metadata
        found = metadata["robot_fingerprint"], metadata["frame_skip"], metadata["task"]
        stored = list(dataset.iterate_episodes())
    except (OSError, KeyError, ValueError, AssertionError) as error:
        raise CdcsrError(
            f"{folder} holds no demonstrations made by `cdcsr demonstrate`: {error}."
        ) from None
    if found[0] != robot_fingerprint:
        raise CdcsrError(
            f"The demonstrations in {folder} are of robot {metadata['robot']!r} ({found[0]}), not of the robot asked "
            f"for ({robot_fingerprint}); record new ones with `cdcsr demonstrate`."
        )
    if found[1] != frame_skip:
        raise CdcsrError(
            f"The demonstrations in {folder} have frame_skip {found[1]}, not {frame_skip}."
        )
    if task is not None and found[2] != task:
        raise CdcsrError(
            f"The demonstrations in {folder} are of the task {found[2]!r}, not {task!r}; record some with "
            f"`cdcsr demonstrate --task {task}`."
        )
    return [
        Episode(
            np.asarray(e.observations),
            np.asarray(e.actions),
            np.asarray(e.observations)[0, TARGET],
            np.asarray(e.rewards, dtype=np.float64),
            bool(np.asarray(e.terminations)[-1]),
        )
        for e in stored
    ]
