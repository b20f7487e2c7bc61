"""What a learner draws its batches from: collected episodes and, if wanted, others that are kept apart from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.task import Task
from training.config.run_config import Learner
from training.experience.collector import FinishedEpisode
from training.experience.hindsight import relabel
from training.experience.replay import Batch, Replay
from training.networks.mirror import Folding

Array = NDArray[np.float64]


class Memory:
    """Two replay buffers, of which the second is there only if a share of each batch is to come from it.

    Args:
        robot: the description.
        learner: the learner's numbers.
        clone: from observations (n, 23 + C) to the behaviour clone's actions (n, C), once for each observation, so
            that no update computes them again; None where nobody asks for them.
        task: says to hindsight what success is. Where it does not end an episode, every action on target pays, and a
            sparse reward is stored times 1 - discount: values then lie in [0, 1], as they do elsewhere.
    """

    def __init__(
        self,
        robot: Robot,
        learner: Learner,
        clone: Callable[[Array], NDArray[np.float32]] | None,
        task: Task,
    ) -> None:
        self._learner, self._clone, self._task = learner, clone, task
        self._folding = Folding(robot) if learner.symmetry else None
        self._pay = 1.0 if task.ends or task.reward_kind != "sparse" else 1 - learner.discount

        def replay() -> Replay:
            size = observation_size(robot)
            return Replay(
                learner.capacity, size, robot.num_cables, learner.discount, learner.return_steps
            )

        self.replays = {"replay": replay()}
        """By name, for a checkpoint."""
        if learner.kept_share > 0:
            self.replays["kept"] = replay()

    @property
    def ready(self) -> bool:
        """Whether there is enough for a batch."""
        return max(replay.size for replay in self.replays.values()) >= self._learner.batch_size

    def begin(self, episodes: Iterable[FinishedEpisode]) -> None:
        """Store what is there before anything is collected; it is kept, if anything is."""
        for episode in episodes:
            self._store(self.replays.get("kept", self.replays["replay"]), episode)

    def add(self, episode: FinishedEpisode, rng: np.random.Generator) -> None:
        """Store a collected episode, and what hindsight makes of it."""
        self._store(self.replays["replay"], episode)
        if self._learner.keep_successes and episode.success and "kept" in self.replays:
            self._store(self.replays["kept"], episode)
        for _ in range(self._learner.hindsight):
            other = relabel(episode, self._task, rng)
            if other is not None:
                self._store(self.replays["replay"], other)

    def sample(self, rng: np.random.Generator) -> Batch:
        """A batch, of which the kept episodes give their share, or all of it until enough is collected."""
        size, collected = self._learner.batch_size, self.replays["replay"]
        if "kept" not in self.replays:
            return collected.sample(size, rng)
        kept = self.replays["kept"]
        if collected.size < size:
            return kept.sample(size, rng)
        share = round(self._learner.kept_share * size)
        parts = collected.sample(size - share, rng), kept.sample(share, rng)
        return Batch(*(torch.cat(both) for both in zip(*parts, strict=True)))

    def _store(self, replay: Replay, episode: FinishedEpisode) -> None:
        observations, actions = episode.observations, episode.actions
        if self._folding is not None:
            # Each row by itself: where the target moves, an episode's rows need not be folded alike. A value does not
            # change with the image it is taken in, so a transition may lead from one to another.
            folded, cables = self._folding(torch.from_numpy(observations))
            observations = folded.numpy()
            actions = np.take_along_axis(actions, cables.numpy()[:-1], -1)
        clone = None if self._clone is None else self._clone(observations)
        rewards = self._pay * episode.rewards - self._learner.step_cost
        replay.add_episode(observations, actions, rewards, episode.terminated, clone)
