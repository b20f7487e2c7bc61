"""Memory: whose share of a batch is whose; hindsight against brute force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.robot import load_robot
from cdcsr.tasks import make_task
from training.collector import FinishedEpisode
from training.config import Learner
from training.hindsight import relabel
from training.memory import Memory

_TASK = make_task("reach")
_ROBOT = load_robot("planar-single")
_SIZE = 23 + _ROBOT.num_cables


def _episode(length: int, mark: float, success: bool = True) -> FinishedEpisode:
    observations = np.full((length + 1, _SIZE), mark)
    return FinishedEpisode(
        observations, np.full((length, _ROBOT.num_cables), 0.5), np.eye(length)[-1], success, success
    )


def _clone(observations: NDArray[np.float64]) -> NDArray[np.float32]:
    return (observations[:, : _ROBOT.num_cables] + 1).astype(np.float32)


def _memory(**numbers: object) -> Memory:
    learner = dataclasses.replace(Learner(batch_size=40, capacity=1000), **numbers)  # type: ignore[arg-type]
    return Memory(_ROBOT, learner, _clone, _TASK)


def test_kept_episodes_have_their_share_of_every_batch() -> None:
    memory, rng = _memory(kept_share=0.25), np.random.default_rng(0)
    memory.begin([_episode(60, mark=1)])
    assert (memory.sample(rng).observation[:, 0] == 1).all()  # all there is
    memory.add(_episode(200, mark=2), rng)
    for _ in range(5):
        batch = memory.sample(rng)
        assert ((batch.observation[:, 0] == 1).sum(), len(batch.observation)) == (10, 40)
        assert (batch.bc_action[:, 0] == batch.observation[:, 0] + 1).all()
    assert (memory.replays["kept"].size, memory.replays["replay"].size) == (61, 201)


def test_without_a_share_everything_is_one() -> None:
    memory, rng = _memory(), np.random.default_rng(0)
    memory.begin([_episode(60, mark=1)])
    memory.add(_episode(60, mark=2), rng)
    assert memory.replays["replay"].size == 122
    assert 200 < sum((memory.sample(rng).observation[:, 0] == 1).sum() for _ in range(12)) < 280  # of 480


def test_successes_are_kept_only_if_asked() -> None:
    for keep, size in ((False, 0), (True, 11)):
        memory, rng = _memory(kept_share=0.5, keep_successes=keep), np.random.default_rng(0)
        memory.add(_episode(10, 1.0, success=True), rng)
        memory.add(_episode(20, 1.0, success=False), rng)
        assert memory.replays["kept"].size == size
        assert memory.replays["replay"].size == 32


@pytest.mark.parametrize(("task", "reward", "stored"), [("reach", None, 1.0), ("follow-line", None, 0.25),
                                                         ("follow-line", "dense", 1.0)])  # fmt: skip
def test_values_of_a_task_that_does_not_end_stay_below_one(task: str, reward: str | None, stored: float) -> None:
    learner = Learner(batch_size=4, capacity=100, discount=0.75)
    memory = Memory(_ROBOT, learner, _clone, make_task(task, reward_kind=reward))
    rewards = np.ones(40)
    episode = dataclasses.replace(_episode(40, 1.0), rewards=rewards, terminated=False)
    memory.begin([episode])
    rows = memory.replays["replay"].rows
    np.testing.assert_allclose(rows["reward"][:40], stored)
    # On target for ever is worth 1: r + gamma r + ... = r / (1 - gamma).
    assert rows["outcome"][0] == pytest.approx(stored / 0.25, rel=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_hindsight_against_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    length, threshold = 80, 0.03
    observations = rng.normal(size=(length + 1, _SIZE))
    observations[:, 0:3] = np.cumsum(rng.normal((0.01, 0, 0), 0.01, size=(length + 1, 3)), axis=0)
    actions = rng.uniform(-1, 1, (length, 4))
    episode = FinishedEpisode(observations, actions, np.zeros(length), False, False)
    before = observations.copy()
    other = relabel(episode, _TASK, rng)
    if other is None:
        return
    target, done = other.observations[0, 6:9], len(other.actions)
    start = observations[:, 0].tolist().index(other.observations[0, 0])
    near = [float(np.linalg.norm(tip - target)) <= threshold for tip in observations[start:, 0:3]]
    assert near.index(True) == done >= 1
    assert other.success
    assert other.rewards.tolist() == [0.0] * (done - 1) + [1.0]
    assert (other.observations[:, 6:9] == target).all()
    np.testing.assert_allclose(
        other.observations[:, 9], [np.linalg.norm(row[0:3] - target) for row in other.observations], rtol=1e-12
    )
    untouched = np.r_[0:6, 10:_SIZE]
    np.testing.assert_array_equal(other.observations[:, untouched], before[start : start + done + 1, untouched])
    np.testing.assert_array_equal(other.actions, actions[start : start + done])
    np.testing.assert_array_equal(observations, before)


def test_hindsight_pays_as_the_task_does() -> None:
    """Following is paid for every action on target, and goes on until time is up."""
    rng = np.random.default_rng(1)
    observations = np.zeros((401, _SIZE))
    observations[1:, 0] = 1 + rng.uniform(-0.001, 0.001, 400)  # there at once, and stays
    episode = FinishedEpisode(observations, np.zeros((400, 4)), np.zeros(400), False, False)
    task = make_task("follow-line", motion="rest")
    other = next(filter(None, (relabel(episode, task, rng) for _ in range(2000))))  # begins away from it: rarely
    assert (len(other.actions), other.terminated, other.success) == (400, False, True)
    near = np.abs(np.linalg.norm(other.observations[1:, 0:3] - other.observations[0, 6:9], axis=1)) <= 0.03
    assert near.mean() > 0.9
    np.testing.assert_array_equal(other.rewards, near.astype(float))


def test_hindsight_takes_pieces_from_anywhere_to_anywhere_later() -> None:
    rng = np.random.default_rng(0)
    found = [relabel(_straight(200), _TASK, rng) for _ in range(2000)]
    pieces = [other for other in found if other is not None]
    starts = np.array([other.observations[0, 0] * 100 for other in pieces])
    ends = starts + [len(other.actions) for other in pieces]
    # Of T actions a start is uniform, and what is then reached uniform in what is left.
    assert np.histogram(starts[starts < 180], 9, (0, 180))[0].min() > 130
    left = (ends - starts) / (200 - starts)
    assert np.histogram(left[starts < 100], 4, (0.04, 1))[0].min() > 180


@pytest.mark.parametrize("copies", [1, 4])
def test_hindsight_stores_each_transition_so_often_on_average(copies: int) -> None:
    """Andrychowicz et al. 2017: k transitions in hindsight to each one that was made."""
    memory = _memory(hindsight=copies, capacity=10_000)
    memory.add(_straight(200), np.random.default_rng(0))
    replay = memory.replays["replay"]
    begins = int((replay.rows["successor"][: replay.size] >= 0).sum())  # but for an episode's last rows
    assert 200 + copies * 200 <= begins < 200 + copies * 200 + 200


def test_hindsight_gives_up_where_the_tip_did_not_move() -> None:
    memory = _memory(hindsight=4)
    memory.add(_episode(10, 1.0, success=False), np.random.default_rng(0))
    assert memory.replays["replay"].size == 11


def _straight(length: int) -> FinishedEpisode:
    """An episode whose tip moves along x by 0.01 m with each action."""
    observations = np.zeros((length + 1, _SIZE))
    observations[:, 0] = 0.01 * np.arange(length + 1)
    return FinishedEpisode(observations, np.zeros((length, 4)), np.zeros(length), False, False)
