"""Statistics of the study, against hand computation, scipy and rliable."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest, trim_mean

from training.measure.statistics import (
    Sweep,
    band,
    bootstrap,
    disagreement,
    halving,
    iqm,
    mean,
    over_few_seeds,
    pooled,
    rate,
    wilson,
)

REFERENCE = json.loads((Path(__file__).parents[2] / "support" / "rliable.json").read_text("utf-8"))
"""The numbers of rliable for the same scores; made by rliable_reference.py."""


def flags(*shares: tuple[int, int]) -> list[np.ndarray]:
    """Seeds with so many successes of so many episodes."""
    return [np.arange(total) < successes for successes, total in shares]


@pytest.mark.parametrize("case", REFERENCE["cases"])
def test_mean_iqm_and_their_intervals_are_rliables(case: str) -> None:
    reference = REFERENCE["cases"][case]
    scores = np.array(reference["scores"])
    for i, statistic in enumerate((mean, iqm)):
        assert statistic(scores) == pytest.approx(reference["mean_iqm"][i], abs=1e-12)
        expected = [row[i] for row in reference["low_high"]]
        assert bootstrap(scores, statistic) == pytest.approx(expected, abs=0.004)  # of other draws


@pytest.mark.parametrize("runs", [1, 3, 4, 5, 8, 10])
def test_iqm_is_scipys_trimmed_mean(runs: int) -> None:
    scores = np.random.default_rng(runs).random((runs, 3))
    assert iqm(scores) == pytest.approx(trim_mean(scores.ravel(), 0.25), abs=1e-12)


def test_iqm_by_hand() -> None:
    # Of 0, 1, ..., 7, two are cut at either end: (2 + 3 + 4 + 5) / 4. An outlier changes nothing.
    assert iqm(np.arange(8.0)[:, None]) == 3.5
    assert iqm(np.array([[0.0], [1], [2], [3], [4], [5], [6], [700]])) == 3.5


def test_bootstrap_keeps_tasks_apart() -> None:
    # The runs of a task agree, so resampling within tasks cannot change the mean.
    assert bootstrap(np.array([[0.0, 1.0]] * 4), mean) == (0.5, 0.5)


def test_one_seed_has_wilsons_interval_and_says_so() -> None:
    # p = 0.9, n = 10, z² = 3.8415: (0.9 + 0.19207 ± 1.95996 sqrt(0.009 + 0.0096036)) / 1.38415.
    found = rate(flags((9, 10)))
    assert (found.value, found.low, found.high) == pytest.approx((0.9, 0.59585, 0.98212), abs=1e-5)
    assert found.over == "episodes"


def test_wilsons_interval_is_scipys() -> None:
    for successes, total in itertools.chain(
        ((k, n) for n in range(1, 21) for k in range(n + 1)), ((0, 300), (151, 300), (9999, 10000))
    ):
        expected = binomtest(successes, total).proportion_ci(0.95, method="wilson")
        assert wilson(successes, total) == pytest.approx((expected.low, expected.high), rel=1e-14)


def test_seeds_weigh_the_same_whatever_their_episodes() -> None:
    found = rate(flags((10, 10), (0, 30)))
    assert (found.value, found.low, found.high, found.over) == (0.5, 0.0, 1.0, "seeds")
    assert pooled(flags((10, 10), (0, 30))).value == 0.25


def test_band_is_the_mean_between_its_bounds() -> None:
    curves = np.array([[0.0, 0.2], [0.5, 0.2], [1.0, 0.2]])
    middle, low, high = band(curves)
    np.testing.assert_allclose(middle, [0.5, 0.2])
    # All three draws are the first curve in one of 27 resamples, 3.7 % of them: more than is cut.
    np.testing.assert_allclose(low, [0.0, 0.2], atol=1e-12)
    np.testing.assert_allclose(high, [1.0, 0.2], atol=1e-12)


def test_disagreement_counts_each_side() -> None:
    first, second = np.array([True, True, True, False]), np.array([True, False, False, True])
    assert disagreement(first, second) == (2, 1)


def sweep(levels: list[float], successes: list[int], total: int = 100) -> Sweep:
    """The first so many episodes succeed at each level."""
    return Sweep(np.array(levels), np.arange(total)[:, None] < np.array(successes))


def test_halving_of_a_known_line() -> None:
    # 80 at 1; half is 40. Above: 60 at 2 and 20 at 4, so 40 at 3.
    # Below: 80 at 0.5 and 0 at 0.1, so 40 at 0.3.
    line = sweep([0.1, 0.5, 1.0, 2.0, 4.0], [0, 80, 80, 60, 20])
    above, below = halving([line], 1.0, "above"), halving([line], 1.0, "below")
    assert above is not None
    assert below is not None
    assert above.level == pytest.approx(3.0)
    assert below.level == pytest.approx(0.3)
    assert 2.3 < above.low < 3.0 < above.high < 3.7
    # Below, all episodes that succeed at 1 do so at 0.5, and none at 0.1: half is always midway.
    assert (below.low, below.high) == pytest.approx((0.3, 0.3))


def test_halving_is_the_mean_over_seeds_with_levels_of_their_own() -> None:
    found = halving(
        [sweep([1.0, 2.0], [100, 0]), sweep([1.0, 2.0, 4.0], [100, 100, 0])], 1.0, "above"
    )
    assert found is not None
    assert found.level == pytest.approx((1.5 + 3.0) / 2)
    # Both draws are the same seed in half of the resamples.
    assert (found.low, found.high) == pytest.approx((1.5, 3.0))


def test_halving_takes_the_nearest_crossing() -> None:
    found = halving([sweep([0.0, 1.0, 2.0, 3.0], [100, 0, 100, 0])], 0.0, "above")
    assert found is not None
    assert found.level == pytest.approx(0.5)


def test_halving_says_when_there_is_none() -> None:
    never = halving([sweep([1.0, 2.0], [100, 80])], 1.0, "above")
    assert never is not None
    assert never.level == np.inf
    below = halving([sweep([0.5, 1.0], [80, 100])], 1.0, "below")
    assert below is not None
    assert below.level == -np.inf
    assert halving([sweep([1.0, 2.0], [100, 0])], 1.0, "below") is None  # not swept
    assert halving([sweep([1.0, 2.0], [0, 0])], 1.0, "above") is None  # nothing to halve


@pytest.mark.parametrize(("mean", "deviation"), [(0.5, 0.09), (0.85, 0.04), (0.95, 0.02)])
def test_an_interval_over_five_seeds_covers_the_mean_of_all_seeds(
    mean: float, deviation: float
) -> None:
    """Success of a seed is drawn from a beta distribution, and 100 episodes of it."""
    rng, total = np.random.default_rng(0), 4_000
    concentration = mean * (1 - mean) / deviation**2 - 1
    rates = rng.beta(mean * concentration, (1 - mean) * concentration, (total, 5, 1))
    found = [over_few_seeds(one) for one in rng.random((total, 5, 100)) < rates]
    covered = np.mean([one.low <= mean <= one.high for one in found])
    assert 0.93 <= covered <= 0.97


def test_an_interval_over_five_seeds_covers_a_difference() -> None:
    """A target is lost with a probability that differs between seeds, and rarely won."""
    rng, total = np.random.default_rng(1), 4_000
    lost = rng.normal(0.15, 0.03, (total, 5, 1))
    draw = rng.random((total, 5, 100))
    scores = np.where(draw < lost, -1, np.where(draw > 0.98, 1, 0))
    found = [over_few_seeds(one, paired=True) for one in scores]
    assert 0.93 <= np.mean([one.low <= 0.02 - 0.15 <= one.high for one in found]) <= 0.97


def test_equal_seeds_get_an_interval_too() -> None:
    every = over_few_seeds(np.ones((5, 100)))
    assert (every.value, every.high) == pytest.approx((1.0, 1.0))
    assert 0.98 < every.low < 0.99
