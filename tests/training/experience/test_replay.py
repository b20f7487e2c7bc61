"""Replay: n-step returns by hand, successors, and the ring."""

from __future__ import annotations

import numpy as np
import pytest

from training.experience.replay import Replay, n_step_returns, returns_to_go


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


def test_transitions_are_drawn_uniformly() -> None:
    replay = Replay(10, 2, 1, discount=0.9, return_steps=1)
    _episode(replay, 5, success=True, mark=1)
    steps = replay.sample(20_000, np.random.default_rng(0)).observation[:, 1].numpy()
    counts = np.bincount(steps.astype(int), minlength=6)
    assert counts[5] == 0
    assert counts[:5] == pytest.approx(4000, abs=5 * np.sqrt(3200))
