"""One episode of each copy: what counts, and what feeds a controller outside of the loop."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from backends.dm_env import make_dm_environment
from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import State
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.observation import BASE_POSITION, TARGET, observe
from cdcsr.tasks.spaces import make_space
from controllers.controller import Conditions, Controller, Target
from controllers.demonstrations import record
from controllers.feeds import act_on_dm_environment, act_on_simulation, commands_for_log
from controllers.jacobian import JacobianController
from controllers.rollout import Rollout, conditions_in, rollout
from tests.support.controllers import Still
from training.policy import Policy, find_policy

Array = NDArray[np.float64]


class Idle(Controller):
    name = "idle"
    privileged = True

    def __init__(self) -> None:
        self.conditions: list[Conditions] = []
        self.times: list[list[float]] = []

    def begin(self, conditions: Conditions) -> None:
        self.conditions.append(conditions)

    def act(self, state: State, target: Target, time: Array) -> Array:
        self.times.append(time.tolist())
        return np.zeros((len(time), 1))


class Scripted:
    """An environment whose results are given. Targets move by one a step."""

    def __init__(
        self,
        distance: list[list[float]],
        success: list[str],
        terminated: list[str],
        last: list[int],
    ) -> None:
        self.num_envs = len(distance)
        self.targets = self.target_velocity = np.zeros((self.num_envs, 3))
        self.robot = SimpleNamespace(time_step=0.25, num_cables=1)
        self.frame_skip, self.backend, self.max_actions = 2, "none", 4
        self.task = SimpleNamespace(kind="reach")
        self.simulation = SimpleNamespace(state=lambda: None, dynamics=None)
        self._distance = np.array(distance)
        self._success, self._terminated = (
            np.array([[x == "1" for x in row] for row in y]) for y in (success, terminated)
        )
        self._last, self._taken = np.array(last), 0

    def step(self, action: Array) -> tuple[object, ...]:
        k = self._taken
        self._taken += 1
        self.targets += 1.0
        info = {"distance": self._distance[:, k], "is_success": self._success[:, k]}
        observation = np.full((self.num_envs, 1), float(self._taken))
        return (
            observation,
            self._success[:, k] * 1.0,
            self._terminated[:, k],
            self._last <= self._taken,
            info,
        )


@pytest.fixture
def idle() -> Idle:
    return Idle()


@pytest.fixture
def result(idle: Idle) -> Rollout:
    """Five steps of four copies.

    The first copy succeeds at the second step. The second runs out of time at the third, and would
    have succeeded at the fourth. The third is on its target for a moment, but not in the end. The
    last succeeds at the fifth step.
    """
    env = Scripted(
        [
            [0.5, 0.02, 0.01, 0.3, 0.4],
            [0.5, 0.2, 0.3, 0.01, 0.01],
            [0.4, 0.02, 0.3, 0.3, 0.1],
            [0.9, 0.8, 0.7, 0.6, 0.02],
        ],
        ["01000", "00011", "01000", "00001"],
        ["01000", "00011", "00000", "00001"],
        [9, 3, 4, 9],
    )
    return rollout(idle, cast(TaskVectorEnv, env), np.zeros((4, 1)))


def test_success_is_as_an_episode_ends(result: Rollout) -> None:
    assert result.success.tolist() == [True, False, False, True]
    assert result.terminated.tolist() == [True, False, False, True]
    assert result.length.tolist() == [2, 3, 4, 5]


def test_distances_are_up_to_the_end(result: Rollout) -> None:
    assert result.distance.tolist() == [0.02, 0.3, 0.3, 0.02]
    assert result.nearest.tolist() == [0.02, 0.2, 0.02, 0.02]


def test_an_episode_is_cut_to_its_length_and_its_target_is_where_it_was_at_first(
    result: Rollout,
) -> None:
    first, last = result.successes()
    assert first.observations[:, 0].tolist() == [0, 1, 2]
    assert (len(first.actions), first.rewards.tolist()) == (2, [0, 1])
    assert (last.length, last.rewards.tolist()) == (5, [0, 0, 0, 0, 1])
    assert first.target.tolist() == last.target.tolist() == [0, 0, 0]


@pytest.mark.usefixtures("result")
def test_time_counts_from_the_start_and_is_nan_after_the_end(idle: Idle) -> None:
    (conditions,) = idle.conditions
    assert (conditions.period, conditions.stays) == (0.5, False)
    expected = np.tile(0.5 * np.arange(5.0)[:, None], 4)
    expected[2:, 0] = expected[3:, 1] = expected[4:, 2] = np.nan
    np.testing.assert_array_equal(idle.times, expected)


@pytest.mark.parametrize("privileged", [False, True])
def test_only_a_privileged_controller_is_shown_the_true_state(privileged: bool) -> None:
    seen: list[tuple[State, Target]] = []

    class Watcher(Still):
        def act(self, state: State, target: Target, time: Array) -> Array:
            seen.append((state, target))
            return super().act(state, target, time) - 1.0

    env = TaskVectorEnv(
        2,
        "planar-single",
        task="capture-drift",
        frame_skip=50,
        disturbances=Disturbances(base_noise=1.0, packet_loss=1.0),
        autoreset_mode="Disabled",
    )
    watcher = Watcher()
    watcher.privileged = privileged
    observation, _ = env.reset(seed=0)
    done = rollout(watcher, env, observation)
    state, target = seen[-1]
    velocity = env.target_velocity.copy()
    env.close()
    if privileged:
        assert np.abs(state.base_position).max() < 0.1
        assert np.abs(state.cable_tension).max() > 0
        np.testing.assert_array_equal(target.velocity, velocity)
        return
    np.testing.assert_array_equal(state.base_position, observation[:, BASE_POSITION])
    np.testing.assert_array_equal(target.position, done.observations[:, -1, TARGET])
    for unknown in (state.cable_tension, state.joint_angles, state.joint_rates, target.velocity):
        assert np.isnan(unknown).all()


def test_eq_1_is_built_again_bit_for_bit_from_what_arrived() -> None:
    """A policy sees the same numbers whether it is given the observation or the state in it."""
    env = TaskVectorEnv(8, disturbances=Disturbances(0.1, 0.01, 0.3, 2), autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    seen: list[Array] = []

    class Watcher(Still):
        def act(self, state: State, target: Target, time: Array) -> Array:
            seen.append(observe(state, target.position))
            return super().act(state, target, time) - 0.1

    done = rollout(Watcher(), env, observation)
    env.close()
    np.testing.assert_array_equal(np.stack(seen, axis=1), done.observations[:, :-1])


def test_each_batch_of_a_recording_has_targets_of_its_own() -> None:
    """All come from one stream, which is drawn again here."""
    env = TaskVectorEnv(2, frame_skip=5, autoreset_mode="Disabled")
    episodes, failed, _ = record(JacobianController(env.robot), env, num=5, seed=3)
    env.close()
    assert failed == 0
    rng, space = np.random.default_rng(3), make_space("anchor", env.robot)
    expected = np.concatenate([space.sample(rng, 2) for _ in range(3)])[:5]
    np.testing.assert_array_equal([episode.target for episode in episodes], expected)


ROBOT = load_robot("paper")
SHIPPED = "batd3-spatter-mujoco"


class Recorder(Controller):
    """Acts as another controller does, and keeps what it is given."""

    def __init__(self, controller: Controller) -> None:
        self.name, self.privileged = controller.name, controller.privileged
        self._controller = controller
        self.states, self.targets = list[State](), list[Target]()

    def begin(self, conditions: Conditions) -> None:
        self._controller.begin(conditions)

    def act(self, state: State, target: Target, time: Array) -> Array:
        self.states.append(state)
        self.targets.append(Target(target.position.copy(), target.velocity.copy()))
        return self._controller.act(state, target, time)


@pytest.mark.parametrize("name", ["jacobian", SHIPPED])
def test_a_simulation_is_driven_as_in_the_environment(name: str) -> None:
    controller = JacobianController(ROBOT) if name == "jacobian" else find_policy(name)
    robot = controller.robot if isinstance(controller, Policy) else ROBOT
    env = TaskVectorEnv(2, robot, frame_skip=5, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    targets = env.targets.copy()
    done = rollout(controller, env, observation)
    num = int(done.length.min())
    simulation = make_simulation(env.robot, "mujoco", 2)
    sent = act_on_simulation(controller, simulation, targets, num, frame_skip=5, stays=False)
    simulation.close()
    env.close()
    np.testing.assert_allclose(sent, np.clip(done.actions[:, :num], -5, 0), atol=1e-12)


@pytest.mark.parametrize("flat", [False, True])
def test_a_dm_env_episode_is_the_environments(flat: bool) -> None:
    policy = find_policy(SHIPPED)
    env = TaskVectorEnv(1, policy.robot, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    done = rollout(policy, env, observation)
    environment = make_dm_environment(robot=policy.robot, seed=4, flat_observation=flat)
    observations, actions = act_on_dm_environment(policy, environment, conditions_in(env))
    environment.close()
    env.close()
    assert len(actions) == done.length[0]
    np.testing.assert_array_equal(observations, done.observations[0])
    np.testing.assert_array_equal(actions, done.actions[0])


def test_a_log_gives_the_commands_that_were_given() -> None:
    policy = find_policy(SHIPPED)
    recorder = Recorder(policy)
    env = TaskVectorEnv(3, policy.robot, frame_skip=10, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    done = rollout(recorder, env, observation)
    commands = commands_for_log(policy, recorder.states, recorder.targets, conditions_in(env))
    env.close()
    np.testing.assert_array_equal(commands, done.actions)
