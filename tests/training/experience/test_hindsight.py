"""Hindsight relabelling against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import DISTANCE, TARGET, TIP_POSITION, observation_size
from training.experience.collector import FinishedEpisode
from training.experience.hindsight import relabel

_TASK = make_task("reach")
_SIZE = observation_size(load_robot("planar-single"))


@pytest.mark.parametrize("seed", range(20))
def test_relabel_against_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    length, threshold = 80, 0.03
    observations = rng.normal(size=(length + 1, _SIZE))
    observations[:, TIP_POSITION] = np.cumsum(
        rng.normal((0.01, 0, 0), 0.01, size=(length + 1, 3)), axis=0
    )
    episode = FinishedEpisode(
        observations, rng.uniform(-1, 1, (length, 4)), np.zeros(length), False, False
    )
    before = observations.copy()
    other = relabel(episode, _TASK, rng)
    if other is None:
        return
    target = other.observations[0, TARGET]
    near = [
        float(np.linalg.norm(tip - target)) <= threshold for tip in observations[:, TIP_POSITION]
    ]
    assert near.index(True) == len(other.actions) >= 1
    assert other.success
    assert other.rewards.tolist() == [0.0] * (len(other.actions) - 1) + [1.0]
    assert (other.observations[:, TARGET] == target).all()
    np.testing.assert_allclose(
        other.observations[:, DISTANCE],
        [np.linalg.norm(row[TIP_POSITION] - target) for row in other.observations],
        rtol=1e-12,
    )
    untouched = np.r_[0:6, 10:_SIZE]
    np.testing.assert_array_equal(
        other.observations[:, untouched], before[: len(other.observations), untouched]
    )
    np.testing.assert_array_equal(other.actions, episode.actions[: len(other.actions)])
    np.testing.assert_array_equal(observations, before)


def test_rewards_are_those_of_the_task() -> None:
    """A followed target pays for every action on target, until the time limit."""
    rng = np.random.default_rng(1)
    observations = np.zeros((401, _SIZE))
    observations[1:, 0] = 1 + rng.uniform(-0.001, 0.001, 400)  # reaches it at once, and stays
    episode = FinishedEpisode(observations, np.zeros((400, 4)), np.zeros(400), False, False)
    other = relabel(episode, make_task("follow-line", motion="rest"), rng)
    assert other is not None
    assert (len(other.actions), other.terminated, other.success) == (400, False, True)
    offset = other.observations[1:, TIP_POSITION] - other.observations[0, TARGET]
    near = np.linalg.norm(offset, axis=1) <= 0.03
    assert near.mean() > 0.9
    np.testing.assert_array_equal(other.rewards, near.astype(float))


def test_targets_lie_all_along_the_path() -> None:
    rng = np.random.default_rng(0)
    observations = np.zeros((201, _SIZE))
    observations[:, 0] = np.linspace(0, 2, 201)
    episode = FinishedEpisode(observations, np.zeros((200, 4)), np.zeros(200), False, False)
    found = [relabel(episode, _TASK, rng) for _ in range(400)]
    lengths = np.array([len(other.actions) for other in found if other is not None])
    # Uniform over the path, except for targets within the threshold of its start.
    assert np.histogram(lengths, 4, (0, 200))[0].min() > 60
