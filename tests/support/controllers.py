"""Controllers for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.simulation.contract import State
from controllers.controller import Controller, Target
from controllers.rollout import command, conditions_in

Array = NDArray[np.float64]


class Still(Controller):
    """Pulls no cable."""

    name = "still"

    def act(self, state: State, target: Target, time: Array) -> Array:
        return np.zeros_like(state.cable_travel)


class Stepper:
    """Lets a controller act in an environment, one action at a time.

    Args:
        controller: it begins here.
        env: what it acts in.
        seed: seeds the targets of the episodes, which begin here.
    """

    def __init__(self, controller: Controller, env: TaskVectorEnv, seed: int) -> None:
        self.controller, self.env = controller, env
        self.observation, _ = env.reset(seed=seed)
        controller.begin(conditions_in(env))

    def command(self, active: NDArray[np.bool_] | None = None) -> Array:
        """Return the commands for the present moment, with time NaN for copies not active."""
        period = self.env.robot.time_step * self.env.frame_skip
        time = self.env.actions_taken * np.float64(period)
        if active is not None:
            time[~active] = np.nan
        return command(self.controller, self.env, self.observation, time)

    def step(self, actions: int = 1) -> None:
        """Make some actions."""
        for _ in range(actions):
            self.observation, *_ = self.env.step(self.command())
