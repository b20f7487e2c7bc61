"""Reach against a state written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.envs.disturbances import BASE_POSITION
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot, shipped_robots
from cdcsr.simulation.contract import State
from cdcsr.tasks.catalogue import Reach, actions_per_episode
from cdcsr.tasks.observation import observation_size

TARGET = np.array([[7.0, 8.0, 9.0], [1.0, 2.0, 3.03]])


@pytest.fixture
def state() -> State:
    """Two copies; the second differs by -100 in all but the tip. No number occurs twice in a row of eq. (1)."""

    def both(*values: float) -> np.ndarray:
        return np.array([values, values]) - np.array([[0.0], [100.0]])

    return State(
        time=np.array([0.5, 0.5]),
        tip_position=np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]),
        tip_velocity=both(4, 5, 6),
        base_position=both(11, 12, 13),
        base_quaternion=both(14, 15, 16, 17),
        base_velocity=both(18, 19, 20),
        base_angular_velocity=both(21, 22, 23),
        cable_travel=both(24, 25, 26),
        cable_tension=both(-1, -1, -1),
        joint_angles=both(-2, -2),
        joint_rates=both(-3, -3),
    )


def test_observation_is_eq_1(state: State) -> None:
    """(p_e, v_e, p_tar, d, p_b, h_b, v_b, omega_b, delta)."""
    task = Reach()
    observation = task.observe(state, TARGET, np.array([10.0, -90.0]))
    assert observation[0].tolist() == [float(i) for i in range(1, 27)]
    assert observation[1, [0, 1, 2, 6, 7, 8]].tolist() == [1, 2, 3, 1, 2, 3.03]
    rest = np.r_[3:6, 9:26]
    assert observation[1, rest].tolist() == (observation[0, rest] - 100).tolist()
    assert observation[0, BASE_POSITION].tolist() == [11, 12, 13]


def test_distance_is_from_tip_to_target(state: State) -> None:
    """(6, 6, 6) and (0, 0, 0.03)."""
    np.testing.assert_allclose(Reach().distance(state, TARGET), [6 * np.sqrt(3), 0.03], rtol=1e-12)


@pytest.mark.parametrize("robot", shipped_robots())
def test_observation_size_counts_the_cables(robot: str) -> None:
    description = load_robot(robot)
    assert observation_size(description) == 23 + description.num_cables


def test_sparse_reward_is_1_on_success() -> None:
    reward = Reach().reward(np.array([0.5, 0.01]), np.array([False, True]))
    assert reward.dtype == np.float64
    assert reward.tolist() == [0.0, 1.0]


def test_dense_reward_is_minus_the_distance_and_1_more_on_success() -> None:
    reward = Reach(reward_kind="dense").reward(np.array([0.5, 0.01]), np.array([False, True]))
    np.testing.assert_allclose(reward, [-0.5, 0.99])


def test_how_many_actions_fit_into_an_episode() -> None:
    assert [actions_per_episode(250, skip) for skip in (1, 3, 125, 126, 250)] == [250, 83, 2, 1, 1]
    for skip in (0, 251):
        with pytest.raises(CdcsrError, match=rf"between 1 and max_steps \(250\), not {skip}"):
            actions_per_episode(250, skip)


def test_an_unknown_reward_is_an_error() -> None:
    with pytest.raises(CdcsrError, match="'sparse' or 'dense', not 'shaped'"):
        Reach(reward_kind="shaped")  # type: ignore[arg-type]
