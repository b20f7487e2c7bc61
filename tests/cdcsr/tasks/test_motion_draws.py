"""What is drawn of a motion when an episode begins, by its statistics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cdcsr.tasks.target_motion import Array, Circle, Drift, Line, Tumble, Wander, make_motion

NUM = 4000
LEAST_P = 1e-4
"""Of the statistical tests; the seeds are fixed, so they pass or fail for good."""


def begun(name: str) -> tuple[Array, Array, Array]:
    """Positions, velocities and what is remembered of many copies."""
    rng = np.random.default_rng(0)
    position = rng.normal(size=(NUM, 3))
    return position, *make_motion(name).begin(rng, position)


def uniform(values: Array, low: float, high: float) -> bool:
    return float(stats.kstest(values, "uniform", args=(low, high - low)).pvalue) > LEAST_P


def isotropic(vectors: Array) -> bool:
    """Archimedes: on a sphere, each coordinate of the direction is uniform; and no two go together."""
    direction = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    together = np.abs(np.corrcoef(direction.T) - np.eye(3)).max()
    return all(uniform(direction[:, axis], -1, 1) for axis in range(3)) and together < 4 / np.sqrt(
        len(direction)
    )


def test_drifts_have_any_direction_and_speed() -> None:
    _, velocity, _ = begun("drift")
    assert isotropic(velocity)
    assert uniform(np.linalg.norm(velocity, axis=1), 0, Drift.speed)


def test_lines_have_speeds_of_their_own() -> None:
    assert uniform(-begun("line")[1][:, 2], Line.slowest, Line.speed)


def test_circles_begin_anywhere_and_go_either_way() -> None:
    position, velocity, memory = begun("circle")
    offset, spin = position - memory[:, :3], memory[:, 3:]
    assert uniform(np.linalg.norm(offset, axis=1), *Circle.radius)
    assert uniform(np.arctan2(offset[:, 1], offset[:, 0]), -np.pi, np.pi)
    np.testing.assert_array_equal(spin[:, :2], 0)
    np.testing.assert_array_equal(np.abs(spin[:, 2]), Circle.rate)
    assert stats.binomtest(int((spin[:, 2] > 0).sum()), NUM).pvalue > LEAST_P
    # Left or right of its radius, as it turns.
    turning = offset[:, 0] * velocity[:, 1] - offset[:, 1] * velocity[:, 0]
    np.testing.assert_array_equal(turning > 0, spin[:, 2] > 0)


def test_tumbling_has_any_axis_rate_and_place() -> None:
    position, _, memory = begun("tumble")
    offset, spin = position - memory[:, :3], memory[:, 3:]
    assert isotropic(offset)
    assert isotropic(spin)
    assert uniform(np.linalg.norm(offset, axis=1), *Tumble.radius)
    assert uniform(np.linalg.norm(spin, axis=1), *Tumble.rate)


@pytest.mark.parametrize("which", [0, 7, 15])
def test_wandering_is_by_accelerations_of_any_size_and_direction(which: int) -> None:
    _, _, memory = begun("random")
    drawn = memory[:, 4:].reshape(NUM, Wander.draws, 3)[:, which]
    assert isotropic(drawn)
    assert uniform(np.linalg.norm(drawn, axis=1), 0, Wander.acceleration)
