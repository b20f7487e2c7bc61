"""The shares of replay and demonstration buffer in a batch, and the stored rewards."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import observation_size
from training.config.learner import Practising
from training.experience.collector import FinishedEpisode
from training.experience.mixed_replay import MixedReplay

_ROBOT = load_robot("planar-single")
_SIZE = observation_size(_ROBOT)


def _episode(length: int, mark: float) -> FinishedEpisode:
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
    replay.prefill([_episode(60, mark=1)])
    assert (replay.sample(rng).observation[:, 0] == 1).all()  # nothing is collected yet
    replay.add(_episode(200, mark=2), rng)
    for _ in range(5):
        batch = replay.sample(rng)
        assert ((batch.observation[:, 0] == 1).sum(), len(batch.observation)) == (10, 40)
        assert (batch.bc_action[:, 0] == batch.observation[:, 0] + 1).all()
    assert (replay.buffers["kept"].size, replay.buffers["replay"].size) == (61, 201)


def test_without_a_share_there_is_one_buffer() -> None:
    replay, rng = _replay(kept_share=0.0), np.random.default_rng(0)
    replay.prefill([_episode(60, mark=1)])
    replay.add(_episode(60, mark=2), rng)
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
    episode = dataclasses.replace(_episode(40, 1.0), rewards=np.ones(40), terminated=False)
    replay.prefill([episode])
    rows = replay.buffers["replay"].rows
    np.testing.assert_allclose(rows["reward"][:40], stored)
    # On target for ever is worth 1: r + gamma r + ... = r / (1 - gamma).
    assert rows["outcome"][0] == pytest.approx(stored / 0.25, rel=1e-4)
