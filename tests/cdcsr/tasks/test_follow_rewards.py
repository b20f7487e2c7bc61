"""Edge cases of following: shares of a few actions, and a base that moves."""

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
    """For example 4 of 5 actions are 80 %, so all 5 must be on target."""
    task = Follow(settling=0.0)
    for hits in range(counted + 1):
        x = np.where(np.arange(counted + 1) <= hits, 0.0, 1.0)  # the first is before any action
        tip = x[:, None] * [1.0, 0.0, 0.0]
        success = task.first_success(tip, np.zeros_like(tip), np.zeros(3)) == counted
        assert success == (hits >= least) == (hits / counted >= 0.9)


def test_a_quiet_follower_is_rewarded_only_while_the_base_is_quiet() -> None:
    rows = np.zeros((5, observation_size(load_robot("paper"))))
    rows[:, BASE_QUATERNION.start] = 1.0
    rows[:, DISTANCE] = [0.5, 0.01, 0.01, 0.5, 0.01]
    rows[2, BASE_POSITION.start] = 0.01  # only after the second action
    for quiet, expected in ((True, [1, 0, 0, 1]), (False, [1, 1, 0, 1])):
        task = make_task("follow-line", quiet=quiet)
        assert task.episode_rewards(rows, False).tolist() == expected
