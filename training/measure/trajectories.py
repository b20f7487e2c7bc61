"""Record commands of the scripted demonstrator, to compare and time engines along them."""

from __future__ import annotations

import numpy as np

from backends.parity.trajectories import DEMONSTRATOR, Commands
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from controllers.jacobian import JacobianController
from controllers.rollout import rollout


def demonstrator_commands(robot: Robot, backend: str, episodes: int, seed: int) -> Commands:
    """Record the demonstrator's commands on the way to random targets in the Anchor Space.

    Failed episodes are included: they serve as well to compare engines.
    """
    env = TaskVectorEnv(episodes, robot, backend, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=seed)
    run = rollout(JacobianController(robot), env, observation)
    env.close()
    actions = np.repeat(run.actions, env.frame_skip, axis=1)
    return Commands(DEMONSTRATOR, actions, env.frame_skip * run.length)
