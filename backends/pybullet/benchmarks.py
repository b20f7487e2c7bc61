"""The section that PyBullet brings to `cdcsr bench`: what cables and worker processes cost or
gain."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pybullet

from backends.pybullet.client import connect, load_robot_body
from backends.pybullet.simulation import PybulletSimulation
from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.contract import Array

_ROUNDS, _EACH = 60, 10


def step(robot: Robot, _: Array) -> Iterator[Measurement]:
    """Compare a step with PyBullet's bare one, with an arm without cables, and among workers."""
    cost, bare = step_cost(robot)
    yield Measurement(
        "pybullet_step",
        cost / bare,
        "PyBullet: cost of a step over bare stepSimulation",
        f"bare stepSimulation: {bare:.0f} us",
        details={"pybullet_step_us": cost, "pybullet_bare_us": bare},
    )
    plain = 1e6 * torque_arm_seconds(robot)
    yield Measurement(
        "pybullet_over_plain_arm",
        cost / plain,
        "PyBullet: cost of a step over that of the same hinges without cables, torques commanded",
        f"plain arm, tip read: {plain:.0f} us",
        details={"plain_arm_us": plain},
    )
    what = "PyBullet, 32 copies: steps/s with two workers over one"
    yield Measurement("workers", worker_gain(robot), what)


def step_cost(robot: Robot) -> tuple[float, float]:
    """Return the time of a step of one copy in this process, and the time of
    `pybullet.stepSimulation` on the same URDF alone; medians, in [us].

    The two take turns under random commands, so that a slow moment of the machine meets both.
    """
    simulation = PybulletSimulation(robot, workers=0)
    client = connect(robot)
    load_robot_body(robot, client)
    random = np.random.default_rng(0)
    commands = robot.full_commands * random.random((_ROUNDS, 1, robot.num_cables))
    simulation.step(commands[0], _EACH)  # the first step compiles
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
    return 1e6 * float(np.median(whole)), 1e6 * float(np.median(bare))


def torque_arm_seconds(robot: Robot, steps: int = 400, rounds: int = 5) -> float:
    """Return the median processor time in [s] of a step of the robot's links under joint torques,
    without cables, and of reading the tip."""
    client = connect(robot)
    body = load_robot_body(robot, client)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    hinges = range(robot.num_cables, count)
    for hinge in hinges:  # there are no springs; without damping the arm would spin ever faster
        pybullet.changeDynamics(body, hinge, jointDamping=1.0, physicsClientId=client)
    torques = np.random.default_rng(0).uniform(-0.1, 0.1, (steps, len(hinges))).tolist()
    times = []
    for _ in range(rounds):
        for joint in range(count):
            pybullet.resetJointState(body, joint, 0.0, 0.0, physicsClientId=client)
        start = time.process_time()
        for torque in torques:
            pybullet.setJointMotorControlArray(
                body, hinges, pybullet.TORQUE_CONTROL, forces=torque, physicsClientId=client
            )
            pybullet.stepSimulation(physicsClientId=client)
            pybullet.getLinkState(body, count - 1, computeLinkVelocity=1, physicsClientId=client)
        times.append(time.process_time() - start)
    pybullet.disconnect(physicsClientId=client)
    return float(np.median(times)) / steps


def worker_gain(robot: Robot, copies: int = 32, steps: int = 40, rounds: int = 5) -> float:
    """Return the steps per second with two worker processes over those with one, taking turns."""
    simulations = [PybulletSimulation(robot, copies, workers=workers) for workers in (1, 2)]
    commands = -np.random.default_rng(0).random((steps, copies, robot.num_cables))
    times: list[list[float]] = []
    for _ in range(rounds + 1):
        times.append([])
        for simulation in simulations:
            simulation.reset()
            start = time.perf_counter()
            for command in commands:
                simulation.step(command)
            times[-1].append(time.perf_counter() - start)
    for simulation in simulations:
        simulation.close()
    one, two = np.median(times[1:], axis=0)  # the first round compiles
    return float(one / two)
