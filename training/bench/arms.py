"""Steps per second of one arm in each engine, and beside them the nearest arms of other projects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import backend_names, engine_title
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
    """One copy of our robot in each engine, and gym-softrobot's arms.

    Args:
        robot: the description.
        python: an interpreter that has gym-softrobot, if any.
        steps: of each turn.
        rounds: turns of each; medians.
    """
    what = f"{robot.num_hinges} hinges and {robot.num_cables} cables on a free base, servo set-points commanded"
    rows = []
    for engine in backend_names():
        seconds = step_seconds(robot, engine, 1, steps, rounds, read=True)
        title = f"ours, {engine_title(engine)}"
        rows.append(Arm(title, what, 1 / seconds, robot.time_step / seconds))
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
