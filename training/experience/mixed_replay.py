"""The replay of a learner: collected episodes and, optionally, a separate demonstration buffer."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.task import Task
from training.config.learner import Practising
from training.experience.collector import FinishedEpisode
from training.experience.hindsight import relabel
from training.experience.replay import Batch, Replay
from training.networks.mirror_symmetry import MirrorSymmetry

Array = NDArray[np.float64]


class MixedReplay:
    """A replay buffer, and a demonstration buffer if it has a share of every batch.

    A task that does not end an episode at success pays for every action on target. Its sparse
    reward is stored times 1 - discount, so that values lie in [0, 1] as in all other tasks.

    Args:
        robot: the description.
        task: defines success for hindsight, and the reward.
        learner: the learner's numbers.
        clone: maps observations (n, observation size) to the behaviour clone's actions (n, C);
            called once for each stored observation. None if the algorithm has no clone.
        kept_share: share of a batch that comes from the demonstration buffer; 0 for no such
            buffer.

    Attributes:
        buffers: the buffers by the names that they have in a checkpoint: `replay` and, if there
            is a demonstration buffer, `kept`.
    """

    def __init__(
        self,
        robot: Robot,
        task: Task,
        learner: Practising,
        clone: Callable[[Array], NDArray[np.float32]] | None = None,
        kept_share: float = 0.0,
    ) -> None:
        self._learner, self._clone, self._task = learner, clone, task
        self._kept_share = kept_share
        self._mirror_symmetry = MirrorSymmetry(robot) if learner.symmetry else None
        endless = not task.ends and task.reward_kind == "sparse"
        self._reward_scale = 1 - learner.discount if endless else 1.0
        self.buffers = {
            name: Replay(
                learner.capacity,
                observation_size(robot),
                robot.num_cables,
                learner.discount,
                learner.return_steps,
            )
            for name in (["replay", "kept"] if kept_share > 0 else ["replay"])
        }

    @property
    def ready(self) -> bool:
        """Whether a batch can be drawn."""
        return max(buffer.size for buffer in self.buffers.values()) >= self._learner.batch_size

    def prefill(self, episodes: Iterable[FinishedEpisode]) -> None:
        """Store demonstrations, in the demonstration buffer if there is one."""
        for episode in episodes:
            self._store(self.buffers.get("kept", self.buffers["replay"]), episode)

    def add(self, episode: FinishedEpisode, rng: np.random.Generator) -> None:
        """Store a collected episode and its copies with targets chosen in hindsight."""
        self._store(self.buffers["replay"], episode)
        for _ in range(self._learner.hindsight):
            relabeled = relabel(episode, self._task, rng)
            if relabeled is not None:
                self._store(self.buffers["replay"], relabeled)

    def sample(self, rng: np.random.Generator) -> Batch:
        """Draw a batch.

        The demonstration buffer gives its share of the rows; it gives all of them until enough
        episodes are collected.
        """
        size, collected = self._learner.batch_size, self.buffers["replay"]
        if "kept" not in self.buffers:
            return collected.sample(size, rng)
        kept = self.buffers["kept"]
        if collected.size < size:
            return kept.sample(size, rng)
        share = round(self._kept_share * size)
        parts = collected.sample(size - share, rng), kept.sample(share, rng)
        return Batch(*(torch.cat(both) for both in zip(*parts, strict=True)))

    def _store(self, buffer: Replay, episode: FinishedEpisode) -> None:
        observations, actions = episode.observations, episode.actions
        if self._mirror_symmetry is not None:
            # Each row has an image of its own: a moving target can cross a mirror plane. A
            # transition may join two images, since the value is the same in all of them.
            image = self._mirror_symmetry(torch.from_numpy(observations))
            observations = image.observation.numpy()
            actions = np.take_along_axis(actions, image.cables.numpy()[:-1], -1)
        clone = None if self._clone is None else self._clone(observations)
        rewards = self._reward_scale * episode.rewards
        buffer.add_episode(observations, actions, rewards, episode.terminated, clone)
