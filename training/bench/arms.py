"""Steps per second of one arm in each engine, and beside them the nearest arms of other projects."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pybullet

from backends.pybullet.client import connect, load_robot_body
from cdcsr.robot.description import Robot
from training.bench.peer_process import MissingPeer, Peer
from training.bench.scaling import step_seconds

SOFTROBOT_ARMS = {
    "TendonArmReach-v1": "gym-softrobot: Cosserat rod of 25 elements on a fixed base, 12 tendons whose tensions are"
    " commanded; 1111 steps of 30 us for each command",
    "SoftArmTracking-v0": "gym-softrobot: Cosserat rod of 40 elements on a fixed base, commanded by muscle torques;"
    " 50 steps of 200 us for each command",
}
_STEPS_A_COMMAND = {"TendonArmReach-v1": (1111, 3e-5), "SoftArmTracking-v0": (50, 2e-4)}
_INSTALL = (
    "not measured: pip install gym-softrobot, here or for another interpreter given by --peers"
)

_SOFTROBOT = """
import warnings
warnings.simplefilter("ignore")
import gymnasium, gym_softrobot
env = gymnasium.make("{name}", disable_env_checker=True)
env.reset(seed=0)
env.action_space.seed(0)
def run(commands):
    for _ in range(commands):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
run(1)  # compiles
"""


@dataclass(frozen=True)
class Arm:
    """One row of the table: physics steps and simulated time, per second of one processor."""

    name: str
    what: str
    """What is simulated, or why nothing is."""
    steps_per_second: float | None = None
    simulated_seconds_per_second: float | None = None


def arms(robot: Robot, python: str, steps: int = 400, rounds: int = 5) -> list[Arm]:
    """One copy of our robot in each engine, a plain PyBullet arm, and gym-softrobot's arms.

    Args:
        robot: the description.
        python: an interpreter that has gym-softrobot, if any.
        steps: of each turn.
        rounds: turns of each; medians.
    """
    what = f"{robot.num_hinges} hinges and {robot.num_cables} cables on a free base, servo set-points commanded"
    rows = []
    for engine, title in (("mujoco", "ours, MuJoCo"), ("pybullet", "ours, PyBullet")):
        seconds = step_seconds(robot, engine, 1, steps, rounds, read=True)
        rows.append(Arm(title, what, 1 / seconds, robot.time_step / seconds))
    seconds = _torque_arm(robot, steps, rounds)
    what = f"the same {robot.num_hinges} hinges on a free base without cables, joint torques commanded, tip read"
    rows.append(Arm("plain PyBullet", what, 1 / seconds, robot.time_step / seconds))
    for name, what in SOFTROBOT_ARMS.items():
        count, step = _STEPS_A_COMMAND[name]
        try:
            with Peer(_SOFTROBOT.format(name=name), python) as peer:
                seconds = float(np.median([peer.run(2)[1] / 2 for _ in range(rounds)])) / count
        except MissingPeer as missing:
            rows.append(Arm(name, f"{_INSTALL} ({missing})"))
        else:
            rows.append(Arm(name, what, 1 / seconds, step / seconds))
    return rows


def _torque_arm(robot: Robot, steps: int, rounds: int) -> float:
    """Median time of a step of the robot's links under joint torques, and of reading the tip, in [s]."""
    client = connect(robot)
    body = load_robot_body(robot, client)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    hinges = range(robot.num_cables, count)
    for hinge in hinges:  # without its springs the arm would spin ever faster
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
