"""Hindsight: what an episode would have been if its target had been a place it did reach (Andrychowicz et al. 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.tasks import DISTANCE, TARGET, TIP_POSITION
from training.collector import FinishedEpisode

Array = NDArray[np.float64]


def relabel(episode: FinishedEpisode, threshold: float, rng: np.random.Generator) -> FinishedEpisode | None:
    """The episode with a target near where its tip was at a time drawn at random, up to where it succeeds.

    Args:
        episode: of T actions, under the sparse reward.
        threshold: of success, in [m].
        rng: draws the time, and where in the ball of that radius around the tip the target is.

    Returns:
        A successful episode; or None where the target is reached at the start, which teaches nothing.
    """
    tip = episode.observations[:, TIP_POSITION]
    direction = rng.normal(size=3)
    offset = direction * (threshold * np.cbrt(rng.random()) / np.linalg.norm(direction))
    target = tip[rng.integers(1, len(tip))] + offset
    distance = np.linalg.norm(target - tip, axis=1)
    first = int(np.argmax(distance <= threshold))
    if first == 0:
        return None
    observations = episode.observations[: first + 1].copy()
    observations[:, TARGET], observations[:, DISTANCE] = target, distance[: first + 1, None]
    rewards = np.zeros(first)
    rewards[-1] = 1.0
    return FinishedEpisode(observations, episode.actions[:first], rewards, True)
