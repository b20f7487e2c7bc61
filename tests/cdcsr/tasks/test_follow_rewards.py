"""Following, at the edges: shares that are no whole actions, and a base that moves."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.robot.description import load_robot
from cdcsr.tasks.catalogue import Follow, make_task
from cdcsr.tasks.observation import BASE_POSITION, BASE_QUATERNION, DISTANCE, observation_size


@pytest.mark.parametrize(
    ("counted", "least"), [(1, 1), (5, 5), (9, 9), (10, 9), (11, 10), (19, 18), (20, 18)]
)
def test_nine_in_ten_is_no_less(counted: int, least: int) -> None:
    """Of 5 actions 4 are 80 %, so all 5 must be on target."""
    task = Follow(settling=0.0)
    for hits in range(counted + 1):
        memory = task.new_counts(1)
        success = False
        for k in range(counted):
            on_target = np.array([k < hits])
            task._count(on_target, memory)
            success = bool(task._verdict(on_target, memory).success[0])
        assert success == (hits >= least) == (hits / counted >= 0.9)


def test_a_quiet_follower_is_rewarded_by_how_the_base_is_after_each_action() -> None:
    rows = np.zeros((5, observation_size(load_robot("paper"))))
    rows[:, BASE_QUATERNION.start] = 1.0
    rows[:, DISTANCE] = [0.5, 0.01, 0.01, 0.5, 0.01]
    rows[2, BASE_POSITION.start] = 0.01  # after the second action alone
    assert make_task("follow-line", quiet=True).episode_rewards(rows, False).tolist() == [
        1,
        0,
        0,
        1,
    ]
    assert make_task("follow-line").episode_rewards(rows, False).tolist() == [1, 1, 0, 1]
