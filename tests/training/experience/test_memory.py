"""Memory: whose share of a batch is whose; hindsight against brute force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import TARGET, TIP_POSITION, observation_size
from training.config.run_config import Learner
from training.experience.collector import FinishedEpisode
from training.experience.hindsight import relabel
from training.experience.mixed_replay import Memory

_TASK = make_task("reach")
_ROBOT = load_robot("planar-single")
_SIZE = observation_size(_ROBOT)


def _episode(length: int, mark: float, success: bool = True) -> FinishedEpisode:
    observations = np.full((length + 1, _SIZE), mark)
    return FinishedEpisode(
        observations,
        np.full((length, _ROBOT.num_cables), 0.5),
        np.eye(length)[-1],
        success,
        success,
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
    assert (
        200 < sum((memory.sample(rng).observation[:, 0] == 1).sum() for _ in range(12)) < 280
    )  # of 480


def test_successes_are_kept_only_if_asked() -> None:
    for keep, size in ((False, 0), (True, 11)):
        memory, rng = _memory(kept_share=0.5, keep_successes=keep), np.random.default_rng(0)
        memory.add(_episode(10, 1.0, success=True), rng)
        memory.add(_episode(20, 1.0, success=False), rng)
        assert memory.replays["kept"].size == size
        assert memory.replays["replay"].size == 32


@pytest.mark.parametrize(
    ("task", "reward", "stored"),
    [("reach", None, 1.0), ("follow-line", None, 0.25), ("follow-line", "dense", 1.0)],
)
def test_values_of_a_task_that_does_not_end_stay_below_one(
    task: str, reward: str | None, stored: float
) -> None:
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
        other.observations[:, 9],
        [np.linalg.norm(row[TIP_POSITION] - target) for row in other.observations],
        rtol=1e-12,
    )
    untouched = np.r_[0:6, 10:_SIZE]
    np.testing.assert_array_equal(
        other.observations[:, untouched], before[: len(other.observations), untouched]
    )
    np.testing.assert_array_equal(other.actions, episode.actions[: len(other.actions)])
    np.testing.assert_array_equal(observations, before)


def test_hindsight_pays_as_the_task_does() -> None:
    """Following is paid for every action on target, and goes on until time is up."""
    rng = np.random.default_rng(1)
    observations = np.zeros((401, _SIZE))
    observations[1:, 0] = 1 + rng.uniform(-0.001, 0.001, 400)  # there at once, and stays
    episode = FinishedEpisode(observations, np.zeros((400, 4)), np.zeros(400), False, False)
    other = relabel(episode, make_task("follow-line", motion="rest"), rng)
    assert other is not None
    assert (len(other.actions), other.terminated, other.success) == (400, False, True)
    near = (
        np.abs(
            np.linalg.norm(
                other.observations[1:, TIP_POSITION] - other.observations[0, TARGET], axis=1
            )
        )
        <= 0.03
    )
    assert near.mean() > 0.9
    np.testing.assert_array_equal(other.rewards, near.astype(float))


def test_hindsight_targets_lie_all_along_the_way() -> None:
    rng = np.random.default_rng(0)
    observations = np.zeros((201, _SIZE))
    observations[:, 0] = np.linspace(0, 2, 201)
    episode = FinishedEpisode(observations, np.zeros((200, 4)), np.zeros(200), False, False)
    found = [relabel(episode, _TASK, rng) for _ in range(400)]
    lengths = np.array([len(other.actions) for other in found if other is not None])
    # Uniform over the way, but for what begins within the threshold of the start.
    assert np.histogram(lengths, 4, (0, 200))[0].min() > 60


def test_a_step_cost_makes_values_linear_in_time() -> None:
    memory, rng = _memory(step_cost=0.01, discount=1.0, return_steps=3), np.random.default_rng(0)
    memory.add(_episode(5, 1.0, success=True), rng)
    rows = memory.replays["replay"].rows
    # Five actions from the end three are paid for and the rest is bootstrapped; one from the end: 1 - 0.01.
    np.testing.assert_allclose(rows["reward"][:5], [-0.03, -0.03, 0.97, 0.98, 0.99], atol=1e-7)
    np.testing.assert_array_equal(rows["discount"][:5], [1, 1, 0, 0, 0])
