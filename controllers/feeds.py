"""Let a controller act outside the episode loop: on a simulation, a dm_env environment or a log.

None of these judges whether the tip reaches its target; :mod:`controllers.rollout` does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Channel
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Simulation, State
from cdcsr.tasks.observation import observe
from controllers.controller import Conditions, Controller, Target
from controllers.rollout import seen_in

Array = NDArray[np.float64]


def act_on_simulation(
    controller: Controller,
    simulation: Simulation,
    targets: Array,
    actions: int,
    frame_skip: int,
    stays: bool = True,
) -> Array:
    """Let a controller act on a simulation that was just reset, towards targets that rest.

    Args:
        controller: the controller that acts; it sees the true state.
        simulation: num copies of a robot.
        targets: shape (num, 3), in [m].
        actions: how many actions to make.
        frame_skip: how many simulation steps each action is held for.
        stays: whether the tip is to stay at the target.

    Returns:
        The servo set-points that were sent, shape (num, actions, C), in [m].
    """
    robot, sent = simulation.robot, []
    period = robot.time_step * frame_skip
    controller.begin(Conditions(robot, period, stays, simulation.engine, simulation.dynamics))
    target = Target(targets, np.zeros_like(targets))
    for k in range(actions):
        time = np.full(simulation.num, k * period)
        command = np.clip(controller.act(simulation.state(), target, time), *robot.command_range)
        simulation.step(command, frame_skip)
        sent.append(command)
    return np.stack(sent, axis=1)


class StepByStep:
    """Lets a controller act on one simulation whose target may be moved at any time.

    The tip is to stay at the target, so that the robot follows where the target goes.

    Args:
        controller: it sees the true state if it is privileged, else what eq. (1) holds of it.
        robot: the robot that it is to control.
    """

    def __init__(self, controller: Controller, robot: Robot) -> None:
        self._controller, self.name = controller, controller.name
        self.frame_skip = controller.frame_skip or ruler(robot).frame_skip

    def begin(self, simulation: Simulation) -> None:
        """Begin an episode in a simulation of one copy.

        Raises:
            CdcsrError: the controller cannot act on this robot.
        """
        self._simulation, robot = simulation, simulation.robot
        self._channel: Channel | None = None
        period = robot.time_step * self.frame_skip
        self._controller.begin(
            Conditions(robot, period, True, simulation.engine, simulation.dynamics)
        )

    def act(self, target: Array, time: float, channel: Channel | None = None) -> Array:
        """Return the set-points until the next action, shape (C,), in [m].

        Args:
            target: where the target is now, shape (3,), in [m].
            time: since the episode began, in [s].
            channel: what its observations pass through; another one begins with what it sees now.
        """
        state, now = self._simulation.state(), np.array([time])
        if self._controller.privileged:
            return self._controller.act(state, Target(target[None], np.zeros((1, 3))), now)[0]
        observation = observe(state, target[None])
        if channel is not None:
            first, self._channel = channel is not self._channel, channel
            fresh = np.ones(1, dtype=bool)
            observation = (
                channel.start(observation, fresh) if first else channel.observe(observation)
            )
        return self._controller.act(*seen_in(observation, now, self._simulation.robot), now)[0]


class _TimeStep(Protocol):
    @property
    def observation(self) -> Mapping[str, Array]: ...

    def last(self) -> bool: ...


class DmEnvironment(Protocol):
    """The methods of a `dm_env` environment of dm_control that are used here."""

    def reset(self) -> _TimeStep: ...

    def step(self, action: Array) -> _TimeStep: ...

    def control_timestep(self) -> float: ...


def act_on_dm_environment(
    controller: Controller, environment: DmEnvironment, conditions: Conditions
) -> tuple[Array, Array]:
    """Let a controller act for one episode of a `dm_env` environment.

    Args:
        controller: the controller that acts; it sees eq. (1), as the environment shows it.
        environment: it observes the parts of eq. (1), in that order.
        conditions: the conditions of the episode.

    Returns:
        The observations, shape (T + 1, observation size), and the servo set-points, shape (T, C),
        in [m].
    """
    step, observations, actions = environment.reset(), [], []
    controller.begin(conditions)
    while True:
        observation = np.concatenate([np.ravel(part) for part in step.observation.values()])
        observations.append(observation)
        if step.last():
            return np.array(observations), np.array(actions)
        time = np.array([len(actions) * conditions.period])
        state, target = seen_in(observation[None], time, conditions.robot)
        actions.append(controller.act(state, target, time)[0])
        step = environment.step(actions[-1])


def commands_for_log(
    controller: Controller,
    states: Sequence[State],
    targets: Sequence[Target],
    conditions: Conditions,
) -> Array:
    """Return the commands that a controller would have given at each moment of a log.

    Args:
        controller: the controller; it sees the states of the log.
        states: T moments of num copies, one period apart from the start of an episode on.
        targets: the targets at these moments.
        conditions: the conditions of the log. A controller that needs the equation of motion must
            find here the one of each moment in turn.

    Returns:
        Servo set-points, shape (num, T, C), in [m].
    """
    controller.begin(conditions)
    commands = [
        controller.act(state, target, np.full(len(state.time), k * conditions.period))
        for k, (state, target) in enumerate(zip(states, targets, strict=True))
    ]
    return np.stack(commands, axis=1)
