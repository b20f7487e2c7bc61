"""What the cables cost: a whole simulation step against PyBullet's bare one."""

from __future__ import annotations

import time

import numpy as np
import pybullet

from backends.pybullet.client import connect, load_robot_body
from backends.pybullet.simulation import PybulletSimulation
from cdcsr.robot.description import Robot

_ROUNDS, _EACH = 60, 10


def step_cost(robot: Robot) -> dict[str, float]:
    """Time of a step of one copy in this process, and of `pybullet.stepSimulation` on the same URDF alone.

    The two are measured in turns under random commands, so that a slow moment of the machine meets both.

    Returns:
        ``step_us`` and ``bare_us``, medians in microseconds, and their ``ratio``.
    """
    simulation = PybulletSimulation(robot, workers=0)
    client = connect(robot)
    load_robot_body(robot, client)
    random = np.random.default_rng(0)
    commands = random.uniform(-robot.servos[0].eta, 0.0, (_ROUNDS, 1, robot.num_cables))
    simulation.step(commands[0], _EACH)  # compiles
    whole, bare = [], []
    for command in commands:
        simulation.reset()
        for _ in range(_EACH):
            start = time.perf_counter()
            simulation.step(command)
            middle = time.perf_counter()
            pybullet.stepSimulation(physicsClientId=client)
            whole.append(middle - start)
            bare.append(time.perf_counter() - middle)
    pybullet.disconnect(physicsClientId=client)
    simulation.close()
    step_us, bare_us = 1e6 * float(np.median(whole)), 1e6 * float(np.median(bare))
    return {"ratio": step_us / bare_us, "step_us": step_us, "bare_us": bare_us}
