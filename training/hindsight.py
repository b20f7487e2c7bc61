"""Hindsight: what an episode would have been if its target had been a place it did reach (Andrychowicz et al. 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.observation import BASE_POSITION, BASE_QUATERNION, TIP_POSITION, TIP_VELOCITY, with_target
from cdcsr.task import Task
from training.collector import FinishedEpisode

Array = NDArray[np.float64]


def relabel(episode: FinishedEpisode, task: Task, rng: np.random.Generator) -> FinishedEpisode | None:
    """A piece of the episode, with a target near where its tip was later: Andrychowicz et al.'s strategy "future".

    They give each transition a target of its own; returns over many steps need rows on end that share one.

    Args:
        episode: of T actions.
        task: says what success is; the target is at rest, whatever the task's does.
        rng: draws where the piece begins, when after that the tip was near the target, and where in the ball of the
            threshold's radius around the tip the target is.

    Returns:
        A successful episode, up to its success; or None where it succeeds at no time, or begins on target, which
        teaches nothing.
    """
    start = rng.integers(len(episode.actions))
    rows = episode.observations[start:]
    tip = rows[:, TIP_POSITION]
    direction = rng.normal(size=3)
    offset = direction * (task.threshold * np.cbrt(rng.random()) / np.linalg.norm(direction))
    target = tip[rng.integers(1, len(tip))] + offset
    if np.linalg.norm(target - tip[0]) <= task.threshold:
        return None
    last = task.first_success(
        tip, rows[:, TIP_VELOCITY], target, rows[:, BASE_POSITION], rows[:, BASE_QUATERNION]
    )  # fmt: skip
    if last is None:
        return None
    moved, actions = with_target(rows[: last + 1], target), episode.actions[start : start + last]
    return FinishedEpisode(moved, actions, task.episode_rewards(moved, True), True, task.ends)
