"""Replay by hand, shares of a mixed batch, and hindsight relabelling by brute force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import (
    DISTANCE,
    TARGET,
    TIP_POSITION,
    TIP_VELOCITY,
    observation_size,
)
from training.config.learner import Practising
from training.experience.collector import FinishedEpisode
from training.experience.hindsight import relabel
from training.experience.mixed_replay import MixedReplay
from training.experience.replay import Replay, n_step_returns, returns_to_go

_ROBOT = load_robot("planar-single")
_SIZE = observation_size(_ROBOT)
_TASK = make_task("reach")


def _episode(replay: Replay, length: int, success: bool, mark: float) -> None:
    observations = np.full((length + 1, 2), mark)
    observations[:, 1] = np.arange(length + 1)
    rewards = np.zeros(length)
    rewards[-1] = float(success)
    bc = np.arange(length + 1)[:, None] / 100
    replay.add_episode(observations, np.full((length, 1), mark / 10), rewards, success, bc)


def test_returns_by_hand() -> None:
    # Rewards 1, 2, 4 with gamma = 1/2 and n = 2: 1 + 2/2 = 2, 2 + 4/2 = 4, and 4 alone.
    sums, ends = n_step_returns(np.array([1.0, 2.0, 4.0]), 0.5, 2)
    np.testing.assert_array_equal(sums, [2, 4, 4])
    np.testing.assert_array_equal(ends, [2, 3, 3])


def test_returns_to_go_by_hand() -> None:
    # Rewards 1, 0, 4 with gamma = 1/2: 1 + 4/4, 4/2, 4.
    np.testing.assert_array_equal(returns_to_go(np.array([1.0, 0.0, 4.0]), 0.5), [2, 2, 4])


def test_transitions_of_a_successful_episode() -> None:
    replay = Replay(10, 2, 1, discount=0.5, return_steps=3)
    _episode(replay, 4, success=True, mark=1)
    # From step 1 on, three actions reach the end: the discounted reward counts, nothing is
    # bootstrapped.
    np.testing.assert_allclose(replay.rows["reward"][:4], [0, 0.25, 0.5, 1])
    np.testing.assert_allclose(replay.rows["discount"][:4], [0.125, 0, 0, 0])
    np.testing.assert_allclose(replay.rows["outcome"][:4], [0.125, 0.25, 0.5, 1])
    np.testing.assert_array_equal(replay.rows["successor"][:5], [3, 4, 4, 4, -1])


def test_a_time_limit_is_bootstrapped_through() -> None:
    replay = Replay(10, 2, 1, discount=0.5, return_steps=3)
    _episode(replay, 4, success=False, mark=1)
    np.testing.assert_allclose(replay.rows["discount"][:4], [0.125, 0.125, 0.25, 0.5])
    np.testing.assert_allclose(replay.rows["reward"][:4], 0)


def test_transitions_stay_whole_while_rows_are_overwritten() -> None:
    rng = np.random.default_rng(0)
    replay = Replay(23, 2, 1, discount=0.9, return_steps=3)
    for mark in range(1, 30):
        _episode(replay, int(rng.integers(1, 9)), success=bool(mark % 2), mark=float(mark))
        batch = replay.sample(64, rng)
        step, following = batch.observation[:, 1], batch.next_observation[:, 1]
        # Both sides are of one episode, one to three steps apart, with the right actions.
        assert (batch.observation[:, 0] == batch.next_observation[:, 0]).all()
        assert ((following - step >= 1) & (following - step <= 3)).all()
        np.testing.assert_allclose(batch.action[:, 0], batch.observation[:, 0] / 10, rtol=1e-6)
        np.testing.assert_allclose(batch.next_bc_action[:, 0], following / 100, rtol=1e-6)
    assert replay.size == 23
    assert {int(m) for m in replay.rows["observation"][:, 0]} <= set(range(20, 30))


def test_the_ring_goes_on_at_its_beginning() -> None:
    """Episodes of 3 and 2 actions fill the 7 rows; the next one overwrites the first rows, and its
    last row begins no transition."""
    replay = Replay(7, 2, 1, discount=0.9, return_steps=1)
    assert (replay.rows["successor"] == -1).all()  # nothing to draw yet
    _episode(replay, 3, success=True, mark=1)
    assert (replay.position, replay.size) == (4, 4)
    _episode(replay, 2, success=True, mark=2)
    assert (replay.position, replay.size) == (0, 7)
    _episode(replay, 1, success=True, mark=3)
    assert (replay.position, replay.size) == (2, 7)
    assert replay.rows["observation"][:, 0].tolist() == [3, 3, 1, 1, 2, 2, 2]
    assert replay.rows["successor"].tolist() == [1, -1, 3, -1, 5, 6, -1]
    _episode(replay, 6, success=False, mark=4)
    assert (replay.position, replay.size) == (2, 7)
    assert replay.rows["successor"].tolist() == [1, -1, 3, 4, 5, 6, 0]


def test_transitions_are_drawn_uniformly() -> None:
    replay = Replay(10, 2, 1, discount=0.9, return_steps=1)
    _episode(replay, 5, success=True, mark=1)
    steps = replay.sample(20_000, np.random.default_rng(0)).observation[:, 1].numpy()
    counts = np.bincount(steps.astype(int), minlength=6)
    assert counts[5] == 0
    assert counts[:5] == pytest.approx(4000, abs=5 * np.sqrt(3200))


def _finished(length: int, mark: float) -> FinishedEpisode:
    actions = np.full((length, _ROBOT.num_cables), 0.5)
    return FinishedEpisode(
        np.full((length + 1, _SIZE), mark), actions, np.eye(length)[-1], True, True
    )


def _clone(observations: NDArray[np.float64]) -> NDArray[np.float32]:
    return (observations[:, : _ROBOT.num_cables] + 1).astype(np.float32)


def _replay(kept_share: float) -> MixedReplay:
    learner = Practising(batch_size=40, capacity=1000)
    return MixedReplay(_ROBOT, make_task("reach"), learner, _clone, kept_share)


def test_demonstrations_have_their_share_of_every_batch() -> None:
    replay, rng = _replay(kept_share=0.25), np.random.default_rng(0)
    replay.prefill([_finished(60, mark=1)])
    assert (replay.sample(rng).observation[:, 0] == 1).all()  # nothing is collected yet
    replay.add(_finished(200, mark=2), rng)
    for _ in range(5):
        batch = replay.sample(rng)
        assert ((batch.observation[:, 0] == 1).sum(), len(batch.observation)) == (10, 40)
        assert (batch.bc_action[:, 0] == batch.observation[:, 0] + 1).all()
    assert (replay.buffers["kept"].size, replay.buffers["replay"].size) == (61, 201)


def test_without_a_share_there_is_one_buffer() -> None:
    replay, rng = _replay(kept_share=0.0), np.random.default_rng(0)
    replay.prefill([_finished(60, mark=1)])
    replay.add(_finished(60, mark=2), rng)
    assert {name: buffer.size for name, buffer in replay.buffers.items()} == {"replay": 122}
    drawn = sum(int((replay.sample(rng).observation[:, 0] == 1).sum()) for _ in range(12))
    assert 200 < drawn < 280  # of 480


@pytest.mark.parametrize(
    ("task", "reward", "stored"),
    [("reach", None, 1.0), ("follow-line", None, 0.25), ("follow-line", "dense", 1.0)],
)
def test_values_of_a_task_that_does_not_end_stay_below_one(
    task: str, reward: str | None, stored: float
) -> None:
    learner = Practising(batch_size=4, capacity=100, discount=0.75)
    replay = MixedReplay(_ROBOT, make_task(task, reward_kind=reward), learner)
    episode = dataclasses.replace(_finished(40, 1.0), rewards=np.ones(40), terminated=False)
    replay.prefill([episode])
    rows = replay.buffers["replay"].rows
    np.testing.assert_allclose(rows["reward"][:40], stored)
    # On target for ever is worth 1: r + gamma r + ... = r / (1 - gamma).
    assert rows["outcome"][0] == pytest.approx(stored / 0.25, rel=1e-4)


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


@pytest.mark.parametrize("name", ["reach", "capture"])
def test_a_target_chosen_in_hindsight_drifts_as_the_old_one_did(name: str) -> None:
    """The episode seen from a drifting frame is relabelled as the episode itself."""
    task, rng = make_task(name, period=0.02), np.random.default_rng(3)
    still = rng.normal(size=(81, _SIZE))
    still[:, TIP_POSITION] = np.linspace([0, 0, 0], [0.08, 0, 0], 81)
    still[:, TIP_VELOCITY] = [0.05, 0, 0]
    drift = np.array([0.06, -0.08, 0.05])
    drifting = still.copy()
    drifting[:, TIP_POSITION] += 0.02 * np.arange(81)[:, None] * drift
    drifting[:, TIP_VELOCITY] += drift
    actions, rewards = np.zeros((80, 4)), np.zeros(80)
    one = relabel(FinishedEpisode(still, actions, rewards, False, False), task, _seeded())
    other = relabel(
        FinishedEpisode(drifting, actions, rewards, False, False, drift), task, _seeded()
    )
    assert one is not None
    assert other is not None
    assert len(other.actions) == len(one.actions) > 5
    drifted = 0.02 * np.arange(len(one.observations))[:, None] * drift
    np.testing.assert_allclose(
        other.observations[:, TARGET] - drifted, one.observations[:, TARGET], atol=1e-12
    )
    np.testing.assert_allclose(
        other.observations[:, DISTANCE], one.observations[:, DISTANCE], atol=1e-12
    )


def _seeded() -> np.random.Generator:
    return np.random.default_rng(5)


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
