"""Statistics of a few seeds with some hundred episodes each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Statistic = Callable[[NDArray[np.generic]], Array]
"""Maps scores of shape (..., runs, tasks) to one number each, shape (...)."""

REPETITIONS = 50_000
"""The number of resamples of a bootstrap, as in rliable."""
_QUANTILES = (0.025, 0.975)
_NORMAL_QUANTILE = 1.959963984540054
"""97.5 % of a normal distribution lie below it."""


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float
    over: Literal["seeds", "episodes"] = "seeds"
    """The interval is about other seeds (bootstrap), or other episodes of one policy (Wilson)."""


def wilson(successes: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a proportion (Wilson 1927).

    Without successes its lower end is 0; without failures its upper end is 1.

    Args:
        successes: how many of `total` episodes succeeded.
        total: at least one.
    """
    # The formula of SciPy's `binomtest`, whose import takes half a second.
    share, square = successes / total, _NORMAL_QUANTILE**2
    scale = 2 * (total + square)
    middle = (2 * total * share + square) / scale
    half = _NORMAL_QUANTILE / scale * sqrt(4 * total * share * (1 - share) + square)
    low = middle - half if successes > 0 else 0.0
    return low, middle + half if successes < total else 1.0


def mean(scores: NDArray[np.generic]) -> Array:
    """Return the mean over runs and tasks."""
    return np.asarray(scores, dtype=float).mean(axis=(-2, -1))


def iqm(scores: NDArray[np.generic]) -> Array:
    """Return the interquartile mean over runs and tasks together.

    Of n sorted scores, n // 4 are cut at either end. One odd seed changes it less than the mean,
    and it uses more of the scores than the median (Agarwal et al. 2021, "Deep reinforcement
    learning at the edge of the statistical precipice").
    """
    scores = np.asarray(scores, dtype=float)
    flat = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = flat.shape[-1] // 4
    return flat[..., cut : flat.shape[-1] - cut].mean(axis=-1)


def bootstrap(
    scores: NDArray[np.generic], statistic: Statistic, repetitions: int = REPETITIONS, seed: int = 0
) -> tuple[float, float]:
    """Return the 95 % percentile interval of a statistic, by stratified bootstrap.

    Runs are redrawn for each task separately.

    Args:
        scores: shape (runs, tasks).
        statistic: :func:`mean`, :func:`iqm`, or a similar function.
        repetitions: the number of resamples.
        seed: seeds the resamples.
    """
    values = np.asarray(scores, dtype=float)
    return _bootstrap(values.tobytes(), values.shape, statistic, repetitions, seed)


@cache  # several tables show the same interval
def _bootstrap(
    values: bytes, shape: tuple[int, ...], statistic: Statistic, repetitions: int, seed: int
) -> tuple[float, float]:
    scores, (runs, tasks) = np.frombuffer(values).reshape(shape), shape
    chosen = np.random.default_rng(seed).integers(runs, size=(repetitions, runs, tasks))
    low, high = np.quantile(statistic(scores[chosen, np.arange(tasks)]), _QUANTILES)
    return float(low), float(high)


def over_seeds(scores: NDArray[np.generic], statistic: Statistic = mean) -> Estimate:
    """Return a statistic with its bootstrap interval; scores have shape (runs, tasks)."""
    return Estimate(float(statistic(scores)), *bootstrap(scores, statistic))


def rate(success: Sequence[NDArray[np.bool_]]) -> Estimate:
    """Return the success of one algorithm in one setting: the mean over its seeds.

    With two seeds or more the interval is the bootstrap's over seeds; with one seed it is Wilson's
    over episodes.

    Args:
        success: for each seed, whether each of its episodes succeeded.
    """
    if len(success) == 1:
        return pooled(success)
    return over_seeds(np.array([[one.mean()] for one in success]))


def pooled(success: Sequence[NDArray[np.bool_]]) -> Estimate:
    """Return success over all episodes with Wilson's interval, which is for these policies only."""
    everything = np.concatenate(success)
    low, high = wilson(int(everything.sum()), len(everything))
    return Estimate(float(everything.mean()), low, high, "episodes")


def band(curves: Array, repetitions: int = 2_000, seed: int = 0) -> tuple[Array, Array, Array]:
    """Return the mean of learning curves and, at each point, its 95 % interval over seeds.

    Args:
        curves: shape (seeds, points).
        repetitions: the number of resamples.
        seed: seeds the resamples.

    Returns:
        Mean, low and high, each of shape (points,); for one curve all three are that curve.
    """
    seeds = len(curves)
    weights = (
        np.random.default_rng(seed).multinomial(seeds, np.full(seeds, 1 / seeds), size=repetitions)
        / seeds
    )
    low, high = np.quantile(weights @ curves, _QUANTILES, axis=0)
    return curves.mean(axis=0), low, high


def disagreement(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> tuple[int, int]:
    """Count the episodes that succeed only in the first engine, and only in the second."""
    return int((first & ~second).sum()), int((second & ~first).sum())


@dataclass(frozen=True)
class Sweep:
    """The successes of one policy on plants along one axis."""

    levels: Array
    """Ascending, shape (L,); they include the level of training."""
    outcomes: NDArray[np.bool_]
    """Successes, shape (episodes, L); an episode has the same target at all levels."""


@dataclass(frozen=True)
class Crossing:
    """The level at which success falls to half of the nominal; infinite if beyond the sweep."""

    level: float
    low: float
    high: float


def halving(
    sweeps: Sequence[Sweep],
    nominal: float,
    side: Literal["above", "below"],
    repetitions: int = 2_000,
    seed: int = 0,
) -> Crossing | None:
    """Return the level on one side of nominal at which success first halves: the mean over seeds.

    Success is interpolated linearly between levels. Seeds may have been swept over different
    levels. The interval redraws seeds and, for each seed, its episodes, the same ones at all
    levels; half of the nominal success is computed anew from each resample.

    Args:
        sweeps: the sweep of each seed.
        nominal: the level of training.
        side: the side of `nominal` to look at.
        repetitions: the number of resamples.
        seed: seeds the resamples.

    Returns:
        The level; it is infinite, with the side's sign, if success does not halve within the sweep
        of every seed. None if a seed was not swept on that side, or never succeeds at the nominal
        level.
    """
    rng = np.random.default_rng(seed)
    never = np.inf if side == "above" else -np.inf
    found, redrawn = [], []
    for sweep in sweeps:
        chosen = np.flatnonzero(
            sweep.levels >= nominal if side == "above" else sweep.levels <= nominal
        )
        chosen = chosen if side == "above" else chosen[::-1]
        levels, success = sweep.levels[chosen], sweep.outcomes[:, chosen].astype(float)
        if len(levels) < 2 or levels[0] != nominal or not success[:, 0].any():
            return None
        episodes = len(success)
        weights = (
            rng.multinomial(episodes, np.full(episodes, 1 / episodes), size=repetitions) / episodes
        )
        found.append(_first_half(levels, success.mean(axis=0)[None], never)[0])
        redrawn.append(_first_half(levels, weights @ success, never))
    seeds = rng.integers(len(sweeps), size=(repetitions, len(sweeps)))
    means = np.sort(np.array(redrawn).T[np.arange(repetitions)[:, None], seeds].mean(axis=1))
    low, high = (float(means[round(q * (repetitions - 1))]) for q in _QUANTILES)
    return Crossing(float(np.mean(found)), low, high)


def _first_half(levels: Array, rates: Array, never: float) -> Array:
    """Return for each row of `rates` (B, L) the first level where it is half of its first value."""
    half = rates[:, :1] / 2
    down = rates <= half
    down[:, 0] = False
    last = np.maximum(down.argmax(axis=1), 1)
    rows = np.arange(len(rates))
    before, after = rates[rows, last - 1], rates[rows, last]
    fall = np.where(before > after, before - after, 1.0)
    found = levels[last - 1] + (before - half[:, 0]) / fall * (levels[last] - levels[last - 1])
    return np.where(down.any(axis=1) & (rates[:, 0] > 0), found, never)


def over_few_seeds(scores: NDArray[np.generic], paired: bool = False) -> Estimate:
    """Return a mean over seeds and targets with a 95 % interval that holds for five seeds.

    Seeds are clusters of episodes: the variance of the mean is that of the seeds' means over their
    number, and at least a quarter of what chance alone gives, so that seeds that happen to be equal
    get no interval of zero width. A rate has Wilson's interval for so many independent episodes as
    have that variance, with Student's quantile in place of the normal one (Korn and Graubard 1998,
    with Wilson's interval as in Dean and Pagano 2015). A difference has Student's interval.

    Args:
        scores: shape (seeds, targets), at least two seeds; 0 or 1 for each episode.
        paired: scores are instead differences of two such numbers on the same target.
    """
    from scipy.stats import t

    values = np.asarray(scores, dtype=float)
    seeds, quantile = len(values), float(t.ppf(_QUANTILES[1], len(values) - 1))
    middle = float(values.mean())
    chance = max(float(values.var()), 1 / values.size) / values.size
    variance = max(float(values.mean(axis=1).var(ddof=1)) / seeds, chance / 4)
    if paired:
        half = quantile * variance**0.5
        return Estimate(middle, middle - half, middle + half)
    episodes = middle * (1 - middle) / variance or float(values.size)
    centre = (middle + quantile**2 / (2 * episodes)) / (1 + quantile**2 / episodes)
    half = quantile / (1 + quantile**2 / episodes)
    half *= (middle * (1 - middle) / episodes + quantile**2 / (4 * episodes**2)) ** 0.5
    return Estimate(middle, max(0.0, centre - half), min(1.0, centre + half))
