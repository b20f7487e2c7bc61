"""Eq. (1) and rewards against a state written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot, shipped_robots
from cdcsr.simulation.contract import State
from cdcsr.tasks.catalogue import Reach, actions_per_episode
from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    CABLE_TRAVEL,
    DISTANCE,
    SLICES,
    TIP_POSITION,
    error_scale,
    input_offset,
    input_scale,
    observation_size,
    observe,
    parts_of,
    tip_distance,
    to_state,
)
from cdcsr.tasks.observation import TARGET as TARGET_PART

TARGET = np.array([[7.0, 8.0, 9.0], [1.0, 2.0, 3.03]])


@pytest.fixture
def state() -> State:
    """Return two copies; the second differs by -100 in everything but the tip. No number occurs
    twice in the observation of a copy."""

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
    """The order is (p_e, v_e, p_tar, d, p_b, h_b, v_b, omega_b, delta)."""
    observation = observe(state, TARGET, np.array([10.0, -90.0]))
    assert observation[0].tolist() == [float(i) for i in range(1, 27)]
    assert observation[1, TIP_POSITION].tolist() == [1, 2, 3]
    assert observation[1, TARGET_PART].tolist() == [1, 2, 3.03]
    others = [slice_ for name, slice_ in SLICES.items() if name not in ("tip_position", "target")]
    for part in others:
        assert observation[1, part].tolist() == (observation[0, part] - 100).tolist()
    assert observation[0, BASE_POSITION].tolist() == [11, 12, 13]
    assert observation[:, DISTANCE].tolist() == [10, -90]


def test_the_distance_is_computed_where_it_is_not_given(state: State) -> None:
    distance = tip_distance(state, TARGET)
    np.testing.assert_array_equal(observe(state, TARGET), observe(state, TARGET, distance))


def test_the_parts_have_names_and_shapes(state: State) -> None:
    parts = parts_of(state, TARGET, np.array([10.0, -90.0]))
    assert list(parts) == list(SLICES)
    assert all(part.shape[0] == 2 and part.ndim == 2 for part in parts.values())
    np.testing.assert_array_equal(
        np.concatenate(list(parts.values()), axis=1),
        observe(state, TARGET, parts["distance"][:, 0]),
    )


def test_an_observation_gives_back_the_state_that_it_holds() -> None:
    robot = load_robot("paper")
    rng = np.random.default_rng(0)
    observation = rng.normal(size=(3, observation_size(robot)))
    state = to_state(observation, np.arange(3.0), robot)
    np.testing.assert_array_equal(
        observe(state, observation[:, TARGET_PART], observation[:, DISTANCE]), observation
    )
    assert state.time.tolist() == [0, 1, 2]
    for hidden in (state.cable_tension, state.joint_angles, state.joint_rates):
        assert np.isnan(hidden).all()
    assert state.cable_tension.shape == (3, robot.num_cables)
    assert state.joint_angles.shape == state.joint_rates.shape == (3, robot.num_hinges)


def test_a_network_sees_the_middle_of_the_workspace_at_rest_as_zero() -> None:
    robot = load_robot("paper")
    offset, scale = input_offset(robot), input_scale(robot)
    assert offset.shape == scale.shape == (observation_size(robot),)
    np.testing.assert_array_equal(offset[TIP_POSITION], robot.workspace.center)
    np.testing.assert_array_equal(offset[TARGET_PART], robot.workspace.center)
    assert offset[BASE_QUATERNION].tolist() == [1, 0, 0, 0]
    assert np.count_nonzero(offset) == 2 * np.count_nonzero(robot.workspace.center) + 1
    # Tip and target, their distance; place and turn of the base; its motion; cable travel.
    tip, base = [0.3] * 3 + [1.0] * 3 + [0.3] * 4, [0.1] * (3 + 4 + 3 + 3)
    assert scale.tolist() == tip + base + [0.03] * 8
    assert error_scale(robot) == 0.1


def test_distance_is_from_tip_to_target(state: State) -> None:
    """The differences are (6, 6, 6) and (0, 0, 0.03)."""
    np.testing.assert_allclose(tip_distance(state, TARGET), [6 * np.sqrt(3), 0.03], rtol=1e-12)


@pytest.mark.parametrize("robot", shipped_robots())
def test_observation_size_counts_the_cables(robot: str) -> None:
    description = load_robot(robot)
    assert observation_size(description) == CABLE_TRAVEL.start + description.num_cables


def test_sparse_reward_is_1_on_success() -> None:
    reward = Reach().reward(np.array([0.5, 0.01]), np.array([False, True]))
    assert reward.dtype == np.float64
    assert reward.tolist() == [0.0, 1.0]


def test_dense_reward_is_the_negative_distance_plus_1_on_success() -> None:
    reward = Reach(reward_kind="dense").reward(np.array([0.5, 0.01]), np.array([False, True]))
    np.testing.assert_allclose(reward, [-0.5, 0.99])


def test_how_many_actions_fit_into_an_episode() -> None:
    assert [actions_per_episode(250, skip) for skip in (1, 3, 125, 126, 250)] == [250, 83, 2, 1, 1]
    for skip in (0, 251):
        with pytest.raises(CdcsrError, match=rf"whole number from 1 to 250, not {skip}"):
            actions_per_episode(250, skip)


def test_an_unknown_reward_is_an_error() -> None:
    with pytest.raises(CdcsrError, match="'sparse' or 'dense', not 'shaped'"):
        Reach(reward_kind="shaped")  # type: ignore[arg-type]
