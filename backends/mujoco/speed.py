"""What the environment costs on top of the physics, as a ratio within one process."""

from __future__ import annotations

import time

import numpy as np

from backends.mujoco.active_cables import CURRENT
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot


def vector_env_speed(
    robot: Robot, num: int = 32, steps: int = 150, rounds: int = 7
) -> dict[str, float]:
    """Steps per second of the vector environment over those of bare `mujoco.batch` on the same model and commands.

    The two take turns, so that a busy machine slows both alike; medians over the rounds.
    """
    env = TaskVectorEnv(num, robot, "mujoco")
    env.reset(seed=0)
    bare = MujocoSimulation(robot, num)
    commands = -np.random.default_rng(0).random((steps, num, robot.num_cables))
    control = bare.batch.bind("ctrl")
    times: list[tuple[float, float]] = []
    for _ in range(rounds):
        start = time.perf_counter()
        for command in commands:
            env.step(command)
        middle = time.perf_counter()
        for command in commands:
            control[:] = command
            bare.batch.step(stage=CURRENT)
        times.append((middle - start, time.perf_counter() - middle))
        env.reset()
        bare.reset()
    env.close()
    ours, theirs = np.median(times, axis=0) / (steps * num)
    return {
        "copies": num,
        "ratio": theirs / ours,
        "steps_per_second": 1 / ours,
        "bare_steps_per_second": 1 / theirs,
    }
