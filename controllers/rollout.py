"""The episode loop: let a controller act in an environment, one episode for each copy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.memory import check_memory
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import TARGET, to_state
from controllers.controller import Conditions, Controller, Target

Array = NDArray[np.float64]
Watch = Callable[[int, Mapping[str, Array]], None]
"""Called after each action with the number of actions so far and the environment's info."""


@dataclass(frozen=True)
class Episode:
    """One successful episode of T actions."""

    observations: Array
    """Shape (T + 1, 23 + C)."""
    actions: Array
    """Servo set-points, shape (T, C), in [m]."""
    target: Array
    """Where the target was at the start, shape (3,), in [m]."""
    rewards: Array
    """Shape (T,)."""
    terminated: bool
    """True if success ended the episode; False if time ran out, as it does when following."""

    @property
    def length(self) -> int:
        """T, the number of actions."""
        return len(self.actions)


@dataclass(frozen=True)
class Rollout:
    """One episode of each of N copies, side by side; rows continue after an episode's end."""

    observations: Array
    """Shape (N, steps + 1, 23 + C)."""
    actions: Array
    """Servo set-points, shape (N, steps, C), in [m]."""
    targets: Array
    """Where the targets were at the start, shape (N, 3), in [m]."""
    rewards: Array
    """Shape (N, steps)."""
    success: NDArray[np.bool_]
    """Shape (N,)."""
    terminated: NDArray[np.bool_]
    """True where success ended the episode, False where time ran out, shape (N,)."""
    length: NDArray[np.int64]
    """The number of actions until the end of each episode, shape (N,)."""
    distance: Array
    """From tip to target at that end, shape (N,), in [m]."""
    nearest: Array
    """The least distance until that end, of the plant whatever was observed, (N,), in [m]."""
    diverged: int = 0
    """The number of episodes that ended because the simulation diverged; they are no successes."""

    def successes(self) -> list[Episode]:
        """Return the successful episodes, each cut to its length."""
        return [self._episode(i, n) for i, n in enumerate(self.length) if self.success[i]]

    def _episode(self, i: int, length: int) -> Episode:
        return Episode(
            self.observations[i, : length + 1],
            self.actions[i, :length],
            self.targets[i],
            self.rewards[i, :length],
            bool(self.terminated[i]),
        )


def conditions_in(env: TaskVectorEnv) -> Conditions:
    """Return the conditions that an environment sets for a controller."""
    return Conditions(
        env.robot,
        env.robot.time_step * env.frame_skip,
        env.task.kind != "reach",
        env.backend,
        env.simulation.dynamics,
    )


def command(controller: Controller, env: TaskVectorEnv, observation: Array, time: Array) -> Array:
    """Return a controller's commands for the present moment of an environment.

    Args:
        controller: a controller that has begun.
        env: what a privileged controller is shown the true state of.
        observation: what arrived, shape (num, 23 + C): all that other controllers are shown.
        time: since the start of each episode, shape (num,), in [s]; NaN where it is over.

    Returns:
        Servo set-points, shape (num, C), in [m].
    """
    if controller.privileged:
        target = Target(env.targets, env.target_velocity)
        return controller.act(env.simulation.state(), target, time)
    return controller.act(*seen_in(observation, time, env.robot), time)


def seen_in(observation: Array, time: Array, robot: Robot) -> tuple[State, Target]:
    """Return the state and the target in observations; what eq. (1) does not hold is NaN.

    Args:
        observation: shape (num, 23 + C).
        time: of each copy, shape (num,), in [s].
        robot: the robot that was observed.
    """
    position = observation[:, TARGET]
    return to_state(observation, time, robot), Target(position, np.full_like(position, np.nan))


def rollout(
    controller: Controller,
    env: TaskVectorEnv,
    observation: Array,
    watch: Watch = lambda action, info: None,  # noqa: ARG005
) -> Rollout:
    """Run one episode in each copy.

    Args:
        controller: the controller that acts.
        env: an environment with autoreset disabled that was just reset.
        observation: what the reset returned, shape (num, 23 + C).
        watch: called after each action, to record what a `Rollout` does not hold.
    """
    num = env.num_envs
    row = 2 * env.robot.num_cables + 26  # the numbers of an action: observation, action and reward
    check_memory(
        f"The records of {num} episodes of {env.max_actions} actions",
        2.0 * 8 * row * num * (env.max_actions + 1),
        "take fewer episodes at a time",
    )
    active = np.ones(num, dtype=bool)
    success, ended = np.zeros((2, num), dtype=bool)
    length, diverged = np.zeros(num, dtype=np.int64), 0
    distance, nearest = np.full((2, num), np.inf)
    observations, actions, rewards, targets = [observation], [], [], env.targets.copy()
    conditions = conditions_in(env)
    controller.begin(conditions)
    while active.any():
        time = np.where(active, len(actions) * conditions.period, np.nan)
        action = command(controller, env, observation, time)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        length[active] += 1
        distance[active] = info["distance"][active]
        nearest[active] = np.minimum(nearest, info["distance"])[active]
        success[active] = info["is_success"][active]
        ended |= active & terminated
        if "diverged" in info:
            diverged += int((active & info["diverged"]).sum())
        active &= ~(terminated | truncated)
        watch(len(actions), info)
    return Rollout(
        np.stack(observations, axis=1),
        np.stack(actions, axis=1),
        targets,
        np.stack(rewards, axis=1),
        success,
        ended,
        length,
        distance,
        nearest,
        diverged,
    )
