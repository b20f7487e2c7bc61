"""Target motions draw from the distributions that they declare."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cdcsr.tasks.target_motion import Array, Circle, Drift, Line, Tumble, Wander, make_motion
from tests.support.distributions import LEAST_P, is_isotropic, is_uniform

NUM = 4000


def begun(name: str) -> tuple[Array, Array, Array]:
    """Return the positions, velocities and memories of many copies."""
    rng = np.random.default_rng(0)
    position = rng.normal(size=(NUM, 3))
    return position, *make_motion(name).begin(rng, position)


def test_drifts_are_uniform_in_direction_and_speed() -> None:
    _, velocity, _ = begun("drift")
    assert is_isotropic(velocity)
    assert is_uniform(np.linalg.norm(velocity, axis=1), 0, Drift.speed)


def test_lines_are_uniform_in_speed() -> None:
    assert is_uniform(-begun("line")[1][:, 2], Line.slowest, Line.speed)


def test_circles_are_uniform_in_start_and_direction() -> None:
    position, velocity, memory = begun("circle")
    offset, spin = position - memory[:, :3], memory[:, 3:]
    assert is_uniform(np.linalg.norm(offset, axis=1), *Circle.radius)
    assert is_uniform(np.arctan2(offset[:, 1], offset[:, 0]), -np.pi, np.pi)
    np.testing.assert_array_equal(spin[:, :2], 0)
    np.testing.assert_array_equal(np.abs(spin[:, 2]), Circle.rate)
    assert stats.binomtest(int((spin[:, 2] > 0).sum()), NUM).pvalue > LEAST_P
    # Seen from the centre, the target moves in the direction of the spin.
    turning = offset[:, 0] * velocity[:, 1] - offset[:, 1] * velocity[:, 0]
    np.testing.assert_array_equal(turning > 0, spin[:, 2] > 0)


def test_tumbling_is_uniform_in_axis_rate_and_place() -> None:
    position, _, memory = begun("tumble")
    offset, spin = position - memory[:, :3], memory[:, 3:]
    assert is_isotropic(offset)
    assert is_isotropic(spin)
    assert is_uniform(np.linalg.norm(offset, axis=1), *Tumble.radius)
    assert is_uniform(np.linalg.norm(spin, axis=1), *Tumble.rate)


@pytest.mark.parametrize("which", [0, 7, 15])
def test_wandering_is_uniform_in_size_and_direction_of_acceleration(which: int) -> None:
    _, _, memory = begun("random")
    drawn = memory[:, 4:].reshape(NUM, Wander.draws, 3)[:, which]
    assert is_isotropic(drawn)
    assert is_uniform(np.linalg.norm(drawn, axis=1), 0, Wander.acceleration)
