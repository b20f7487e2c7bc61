"""Commands of the scripted demonstrator, along which engines are compared and timed."""

from __future__ import annotations

from backends.parity.trajectories import DEMONSTRATOR, Commands
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from controllers.demonstrations import rollout
from controllers.jacobian import JacobianController


def demonstrator_commands(robot: Robot, backend: str, episodes: int, seed: int) -> Commands:
    """What the scripted demonstrator commands on its way to random targets in the Anchor Space.

    Whether it arrives does not matter here: an episode that fails is as good for comparing engines.
    """
    env = TaskVectorEnv(episodes, robot, backend, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=seed)
    run = rollout(JacobianController(robot), env, observation)
    env.close()
    return Commands(DEMONSTRATOR, run.actions, run.length)
