"""Target motions against closed formulas, and the distributions that they draw from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cdcsr.errors import CdcsrError
from cdcsr.tasks.target_motion import (
    MOTIONS,
    Array,
    Circle,
    Drift,
    Line,
    Tumble,
    Wander,
    make_motion,
)
from tests.support.distributions import LEAST_P, is_isotropic, is_uniform

STEP = 0.0025


def run(name: str, steps: int, num: int = 6, seed: int = 0) -> tuple[Array, Array, Array]:
    """Return positions and velocities, shape (steps + 1, num, 3), and the first memory."""
    rng, motion = np.random.default_rng(seed), make_motion(name)
    position = rng.normal(size=(num, 3))
    velocity, memory = motion.begin(rng, position)
    first, rows = memory.copy(), [(position.copy(), velocity.copy())]
    for _ in range(steps):
        motion.advance(position, velocity, memory, STEP)
        rows.append((position.copy(), velocity.copy()))
    return np.array([p for p, _ in rows]), np.array([v for _, v in rows]), first


@pytest.mark.parametrize("name", MOTIONS)
def test_velocity_is_the_rate_of_the_position(name: str) -> None:
    """Checked by central differences; a random acceleration jumps by 0.8 m/s^2 at most."""
    position, velocity, _ = run(name, 1000)
    rate = (position[2:] - position[:-2]) / (2 * STEP)
    np.testing.assert_allclose(velocity[1:-1], rate, atol=0.8 * STEP if name == "random" else 2e-6)


@pytest.mark.parametrize("name", ["drift", "line"])
def test_straight_motions_are_start_plus_velocity_times_time(name: str) -> None:
    position, velocity, _ = run(name, 500, num=200)
    np.testing.assert_allclose(position[500], position[0] + velocity[0] * 1.25, atol=1e-12)
    np.testing.assert_array_equal(velocity[500], velocity[0])
    speed = np.linalg.norm(velocity[0], axis=1)
    assert 0.095 < speed.max() <= 0.1
    if name == "line":
        np.testing.assert_array_equal(velocity[0, :, :2], 0)
        assert velocity[0, :, 2].max() <= -0.05
    else:
        assert speed.min() < 0.005
        assert np.abs(velocity[0].mean(axis=0)).max() < 0.02  # no direction is preferred


@pytest.mark.parametrize("name", ["tumble", "circle"])
def test_turning_keeps_distance_to_the_centre_and_height_along_the_axis(name: str) -> None:
    position, velocity, memory = run(name, 1000, num=200)
    center, spin = memory[:, :3], memory[:, 3:]
    radius = np.linalg.norm(position - center, axis=2)
    np.testing.assert_allclose(radius, np.broadcast_to(radius[0], radius.shape), atol=1e-12)
    along = np.sum((position - center) * spin, axis=2)
    np.testing.assert_allclose(along, np.broadcast_to(along[0], along.shape), atol=1e-12)
    speed = np.linalg.norm(velocity, axis=2)
    np.testing.assert_allclose(speed, np.broadcast_to(speed[0], speed.shape), atol=1e-12)
    if name == "tumble":
        assert Tumble.radius[0] <= radius.min()
        assert radius.max() <= Tumble.radius[1]
        assert speed.max() <= 0.1
    else:
        np.testing.assert_allclose(
            position[..., 2], np.broadcast_to(position[0, :, 2], position.shape[:2])
        )
        # 2.5 rad/s for 2.5 s is 6.25 rad: a whole turn except for 0.033 rad.
        short = 2 * radius[0] * np.sin((2 * np.pi - 6.25) / 2)
        np.testing.assert_allclose(
            np.linalg.norm(position[1000] - position[0], axis=1), short, atol=1e-9
        )


def test_each_random_acceleration_lasts_for_100_steps() -> None:
    """The acceleration without spring and damper is constant for 100 steps, then another."""
    position, velocity, memory = run("random", 300, num=3)
    rate = np.diff(velocity, axis=0) / STEP
    drawn = rate + 2.0 * (position[:-1] - position[0]) + 1.0 * velocity[:-1]
    for k in range(3):
        held = drawn[100 * k : 100 * (k + 1)]
        np.testing.assert_allclose(held, np.broadcast_to(held[0], held.shape), atol=1e-9)
        np.testing.assert_allclose(held[0], memory[:, 4 + 3 * k : 7 + 3 * k], atol=1e-9)
    assert (np.linalg.norm(drawn, axis=2) <= Wander.acceleration + 1e-9).all()
    assert (drawn[0] != drawn[100]).all()


def test_a_wandering_target_stays_near_its_start() -> None:
    position, velocity, _ = run("random", 1000, num=300)
    assert np.linalg.norm(position - position[0], axis=2).max() < 0.3
    assert np.linalg.norm(velocity, axis=2).max() < 0.3


def test_an_unknown_motion_is_an_error() -> None:
    with pytest.raises(CdcsrError, match=r"Unknown motion 'tumbel'\. Did you mean 'tumble'\?"):
        make_motion("tumbel")


def test_the_numbers_behind_the_names_of_motions() -> None:
    """Tests of distributions read them from the classes; a task of one name must keep them."""
    assert (Drift.speed, Line.slowest, Line.speed) == (0.1, 0.05, 0.1)  # [m/s]
    assert (Tumble.radius, Tumble.rate) == ((0.03, 0.1), (0.2, 1.0))  # [m], [rad/s]
    assert (Circle.radius, Circle.rate) == ((0.03, 0.06), 2.5)
    assert (Wander.hold, Wander.acceleration, Wander.draws) == (0.25, 0.4, 16)
    assert (Wander.spring, Wander.damper) == (2.0, 1.0)


def test_after_the_last_acceleration_the_first_one_follows() -> None:
    """16 of them last for 4 s."""
    motion, num = make_motion("random"), 2
    position = np.zeros((num, 3))
    velocity, memory = motion.begin(np.random.default_rng(0), position)
    memory[:, 3] = 4.0 - STEP
    for which in (15, 0):
        before, at = velocity.copy(), position.copy()
        motion.advance(position, velocity, memory, STEP)
        drawn = (velocity - before) / STEP + 2.0 * at + before
        expected = memory[:, 4 + 3 * which : 7 + 3 * which]
        np.testing.assert_allclose(drawn, expected, atol=1e-12)


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


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_a_scaled_motion_is_the_same_one_in_other_units(name: str) -> None:
    """In time that runs 3 times as slowly every way is half as long, and every speed a sixth."""
    paths = []
    for motion, size, pace in (
        (MOTIONS[name], 1.0, 1.0),
        (MOTIONS[name].scaled(0.5, 3.0), 0.5, 3.0),
    ):
        position = np.zeros((6, 3))
        velocity, memory = motion.begin(np.random.default_rng(4), position)
        for _ in range(60):
            motion.advance(position, velocity, memory, 0.025 * pace)
        paths.append((position / size, velocity * pace / size))
    for one, other in zip(*paths, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
