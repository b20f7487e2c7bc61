"""Transitions with targets that were reached are those of the episodes stored on a processor."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    DISTANCE,
    SLICES,
    TARGET,
    TIP_POSITION,
    TIP_VELOCITY,
    observation_size,
    with_target,
)
from cdcsr.tasks.task import Task
from training.device.hindsight import HindsightReplay
from training.device.replay import Step
from training.device.streams import Streams
from training.experience.replay import Replay

PAPER, CPU = load_robot("paper"), torch.device("cpu")
COPIES, LONGEST, RETURN_STEPS, DISCOUNT, STEPS = 4, 30, 5, 0.95, 500
SIZES = observation_size(PAPER), PAPER.num_cables
MARK = SLICES["base_velocity"].start  # this number tells rows apart
TASKS = {
    "reach": make_task("reach", PAPER),
    "capture": make_task("capture", PAPER, speed=0.5, dwell=0.02, period=0.005),
    "quiet": make_task("quiet", PAPER),
}


def _filled(
    task: Task, rows: int, hindsight: int = 4, stride: float = 0.012
) -> tuple[HindsightReplay, dict[float, tuple[int, int]], list[NDArray[np.float64]]]:
    """Return a replay of random walks, where each row is (episode, number), and the episodes."""
    rng, empty = np.random.default_rng(0), Replay(1, *SIZES, DISCOUNT, RETURN_STEPS)
    shape = (1, COPIES, rows), SIZES, LONGEST, DISCOUNT, RETURN_STEPS, [empty], CPU
    replay = HindsightReplay(task, hindsight, *shape)
    length = rng.integers(2, LONGEST, size=COPIES, endpoint=True)
    running: list[list[NDArray[np.float64]]] = [[] for _ in range(COPIES)]
    place, episodes = {}, []
    tip = np.zeros((COPIES, 3))
    for step in range(STEPS):
        seen = rng.normal(size=(COPIES, SIZES[0])).astype(np.float32).astype(np.float64)
        tip += stride * rng.normal(size=(COPIES, 3))
        seen[:, TIP_POSITION], seen[:, TIP_VELOCITY] = tip, 0.15 * rng.normal(size=(COPIES, 3))
        seen[:, BASE_POSITION] = 0.001 * rng.normal(size=(COPIES, 3))
        seen[:, BASE_QUATERNION] = [1.0, 0.0, 0.0, 0.0]
        seen[:, MARK] = 1 + step * COPIES + np.arange(COPIES)
        seen = seen.astype(np.float32).astype(np.float64)
        for copy in range(COPIES):
            running[copy].append(seen[copy])
        last = np.array([len(rows) - 1 for rows in running]) == length
        actions = torch.as_tensor(seen[:, None, MARK], dtype=torch.float32).expand(COPIES, SIZES[1])
        none = torch.zeros(1, COPIES, dtype=torch.bool)
        flags = torch.from_numpy(last)[None], none, none
        now = torch.as_tensor(seen, dtype=torch.float32)[None]
        replay.write(Step(now, actions[None], 0 * actions[None], *flags))
        replay.finish(torch.zeros(1, COPIES))
        for copy in np.flatnonzero(last):
            episode = np.array(running[copy])
            place |= {mark: (len(episodes), i) for i, mark in enumerate(episode[:, MARK].tolist())}
            episodes.append(episode)
            running[copy], tip[copy] = [], 0
            length[copy] = rng.integers(2, LONGEST, endpoint=True)
    return replay, place, episodes


@pytest.mark.parametrize("rows", [STEPS, 80])
@pytest.mark.parametrize("name", TASKS)
def test_transitions_lead_to_the_first_success(name: str, rows: int) -> None:
    task = TASKS[name]
    replay, place, episodes = _filled(task, rows)
    batch = replay.sample(600, Streams([5], CPU))
    moved, rewarded, bootstrapped = 0, 0, 0
    for i in range(600):
        row = {key: value[0, i].numpy() for key, value in batch._asdict().items()}
        episode, number = place[float(row["observation"][MARK])]
        seen, target = episodes[episode], row["observation"][TARGET].astype(np.float64)
        if np.abs(target - seen[number, TARGET]).max() < 1e-6:  # its own target
            assert row["reward"] == 0
            continue
        moved += 1
        tip = seen[:, TIP_POSITION]
        apart = np.linalg.norm(tip - target, axis=1)
        assert apart[1:].min() <= task.threshold + 1e-6
        assert apart[0] > task.threshold - 1e-6
        success = task.first_success(
            tip, seen[:, TIP_VELOCITY], target, seen[:, BASE_POSITION], seen[:, BASE_QUATERNION]
        )
        assert success is not None
        left = success - number
        assert left >= 1
        after = number + min(left, RETURN_STEPS)
        ends = left <= RETURN_STEPS
        rewarded += ends
        bootstrapped += not ends
        assert row["reward"] == pytest.approx(DISCOUNT ** (left - 1) if ends else 0, rel=1e-5)
        assert row["discount"] == pytest.approx(0 if ends else DISCOUNT**RETURN_STEPS, rel=1e-5)
        assert row["outcome"] == pytest.approx(DISCOUNT ** (left - 1), rel=1e-5)
        assert row["action"][0] == seen[number, MARK]
        for key, at in (("observation", number), ("next_observation", after)):
            np.testing.assert_allclose(row[key], with_target(seen[at], target), atol=1e-5)
        assert row["observation"][DISTANCE] == pytest.approx(apart[number], abs=1e-5)
    assert rewarded > 20
    assert bootstrapped > 20 or name == "capture"
    # Four of five, where the episode is whole, begins elsewhere and succeeds.
    assert (0.6 if (name, rows) == ("reach", STEPS) else 0.1) < moved / 600 < 0.85


def test_the_new_targets_are_spread_over_the_episode() -> None:
    replay, place, episodes = _filled(TASKS["reach"], STEPS)
    batch, nearest = replay.sample(2000, Streams([5], CPU)), []
    for seen in batch.observation[0].numpy():
        episode, _ = place[float(seen[MARK])]
        tip = episodes[episode][:, TIP_POSITION]
        nearest.append(np.linalg.norm(tip - seen[TARGET], axis=1).argmin() / (len(tip) - 1))
    shares, _ = np.histogram(nearest, 4, (0, 1))
    assert shares.min() > 100


def test_one_copy_is_half_of_what_is_drawn() -> None:
    replay, place, episodes = _filled(TASKS["reach"], STEPS, hindsight=1)
    own = 0
    for seen in replay.sample(2000, Streams([5], CPU)).observation[0].numpy():
        episode, number = place[float(seen[MARK])]
        own += np.abs(seen[TARGET] - episodes[episode][number, TARGET]).max() < 1e-6
    assert 0.5 < own / 2000 < 0.7  # half, and those that cannot be moved


def test_new_targets_fill_a_ball() -> None:
    task = TASKS["reach"]
    replay, place, episodes = _filled(task, STEPS, stride=1.0)  # so far that the tip is known
    shares = []
    for seen in replay.sample(1500, Streams([5], CPU)).observation[0].numpy():
        episode, number = place[float(seen[MARK])]
        if np.abs(seen[TARGET] - episodes[episode][number, TARGET]).max() > 1e-6:
            tips = episodes[episode][:, TIP_POSITION]
            nearest = np.linalg.norm(tips - seen[TARGET], axis=1).min()
            shares.append((nearest / task.threshold) ** 3)
    assert len(shares) > 800
    assert stats.kstest(shares, "uniform").pvalue > 1e-3
