"""Hindsight: what an episode would have been if its target had been a place it did reach (Andrychowicz et al. 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    TIP_POSITION,
    TIP_VELOCITY,
    with_target,
)
from cdcsr.tasks.task import Task
from training.experience.collector import FinishedEpisode

Array = NDArray[np.float64]


def relabel(
    episode: FinishedEpisode, task: Task, rng: np.random.Generator
) -> FinishedEpisode | None:
    """The episode with a target near where its tip was at a time drawn at random, up to where it first succeeds.

    That is the strategy "future" for its first transition. For later ones it is, too, but they are in fewer such
    copies; pieces that begin anywhere would even that out, and taught less ("tried and left" in docs/study.md).

    Args:
        episode: of T actions.
        task: says what success is; the target is at rest, whatever the task's does.
        rng: draws the time, and where in the ball of the threshold's radius around the tip the target is.

    Returns:
        A successful episode; or None where it succeeds at no time, or begins on target, which teaches nothing.
    """
    tip = episode.observations[:, TIP_POSITION]
    direction = rng.normal(size=3)
    offset = direction * (task.threshold * np.cbrt(rng.random()) / np.linalg.norm(direction))
    target = tip[rng.integers(1, len(tip))] + offset
    if np.linalg.norm(target - tip[0]) <= task.threshold:
        return None
    rows = episode.observations
    last = task.first_success(
        tip, rows[:, TIP_VELOCITY], target, rows[:, BASE_POSITION], rows[:, BASE_QUATERNION]
    )
    if last is None:
        return None
    moved = with_target(rows[: last + 1], target)
    return FinishedEpisode(
        moved, episode.actions[:last], task.episode_rewards(moved, True), True, task.ends
    )
