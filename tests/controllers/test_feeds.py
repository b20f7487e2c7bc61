"""The feeds give a controller what the episode loop gives it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from backends.dm_env import make_dm_environment
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import State
from cdcsr.simulation.engines import make_simulation
from controllers.controller import Conditions, Controller, Target
from controllers.feeds import act_on_dm_environment, act_on_simulation, commands_for_log
from controllers.jacobian import JacobianController
from controllers.rollout import conditions_in, rollout
from training.policy import Policy, find_policy

Array = NDArray[np.float64]
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
