"""Hindsight experience replay (Andrychowicz et al. 2017): copies with reached targets."""

from __future__ import annotations

import numpy as np

from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    TIP_POSITION,
    TIP_VELOCITY,
    with_target,
)
from cdcsr.tasks.task import Task
from training.experience.collector import FinishedEpisode


def relabel(
    episode: FinishedEpisode, task: Task, rng: np.random.Generator
) -> FinishedEpisode | None:
    """Move the target to where the tip was at a random time, and cut the episode at its success.

    For the first transition this is the strategy "future" of the source. For a later one it is
    too, but fewer copies contain it. Copies that begin at a random time would correct that, and
    gave lower success ("tried and left" in docs/study.md).

    Args:
        episode: T actions.
        task: defines success. The new target only drifts with the robot, as the old one did, even
            if the task's target moves besides.
        rng: draws the time, and the target's place in a ball of the threshold's radius around
            the tip.

    Returns:
        A successful episode; None if it never succeeds, or if it begins on target, which has
        nothing to teach.
    """
    rows = episode.observations
    drift = np.zeros(3) if episode.drift is None else episode.drift
    # Everything is seen from the frame that drifts, where the new target is at rest.
    drifted = np.arange(len(rows))[:, None] * (task.period * drift)
    tip = rows[:, TIP_POSITION] - drifted
    direction = rng.normal(size=3)
    offset = direction * (task.threshold * np.cbrt(rng.random()) / np.linalg.norm(direction))
    target = tip[rng.integers(1, len(tip))] + offset
    if np.linalg.norm(target - tip[0]) <= task.threshold:
        return None
    last = task.first_success(
        tip, rows[:, TIP_VELOCITY] - drift, target, rows[:, BASE_POSITION], rows[:, BASE_QUATERNION]
    )
    if last is None:
        return None
    moved = with_target(rows[: last + 1], target + drifted[: last + 1])
    rewards = task.episode_rewards(moved, True)
    return FinishedEpisode(moved, episode.actions[:last], rewards, True, task.ends)
