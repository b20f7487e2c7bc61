"""How fast one arm is simulated in each engine, beside the nearest arms of other projects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.engines import engine_title, principal_engines
from training.bench.growth import step_seconds
from training.bench.peer_process import MissingPeer, Peer

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
run(1)  # the first command compiles
"""
_INSTALL = (
    "not measured: pip install gym-softrobot, here or for another interpreter given by --peers"
)


@dataclass(frozen=True)
class SoftrobotArm:
    """An arm of gym-softrobot."""

    name: str
    what: str
    steps: int
    """Physics steps for each command."""
    time_step: float
    """Length of a physics step in [s]."""


SOFTROBOT_ARMS = (
    SoftrobotArm(
        "TendonArmReach-v1",
        "gym-softrobot: Cosserat rod of 25 elements on a fixed base, 12 tendons whose tensions are"
        " commanded; 1111 steps of 30 us for each command",
        1111,
        3e-5,
    ),
    SoftrobotArm(
        "SoftArmTracking-v0",
        "gym-softrobot: Cosserat rod of 40 elements on a fixed base, commanded by muscle torques;"
        " 50 steps of 200 us for each command",
        50,
        2e-4,
    ),
)


@dataclass(frozen=True)
class Speed:
    """One row of the table: the speed of an arm on one processor."""

    name: str
    what: str
    """Says what is simulated, or why nothing is."""
    steps_per_second: float | None = None
    simulated_seconds_per_second: float | None = None


def arms(robot: Robot, python: str) -> Iterator[Measurement]:
    """Measure one copy of the robot in each engine, and the arms of gym-softrobot.

    The value is the simulated time per second of the first engine; the table has all of them.

    Args:
        robot: the description.
        python: an interpreter that may have gym-softrobot.
    """
    rows = [*own_speeds(robot), *(softrobot_speed(arm, python) for arm in SOFTROBOT_ARMS)]
    table = ["physics steps/s   simulated s/s"]
    for row in rows:
        speed, simulated = row.steps_per_second, row.simulated_seconds_per_second
        numbers = (
            f"{'-':>15}   {'-':>13}" if speed is None else f"{speed:15,.0f}   {simulated:13.2f}"
        )
        table.append(f"{numbers}   {row.name}: {row.what}")
    yield Measurement(
        "arm_speed",
        rows[0].simulated_seconds_per_second,
        f"{rows[0].name}: simulated seconds per second, one copy on one processor",
        lines=tuple(table),
        details={"arms": [asdict(row) for row in rows]},
    )


def own_speeds(robot: Robot, steps: int = 400, rounds: int = 5) -> Iterator[Speed]:
    """Measure one copy of a robot in each engine that is no variant; medians over the rounds."""
    what = (
        f"{robot.num_hinges} hinges and {robot.num_cables} cables on a free base,"
        " servo set-points commanded"
    )
    for engine in principal_engines():
        seconds = step_seconds(robot, engine, 1, steps, rounds, read=True)
        name = f"ours, {engine_title(engine)}"
        yield Speed(name, what, 1 / seconds, robot.time_step / seconds)


def softrobot_speed(arm: SoftrobotArm, python: str, rounds: int = 5) -> Speed:
    """Measure an arm of gym-softrobot, if the interpreter has it; median over the rounds."""
    try:
        with Peer(_SOFTROBOT.format(name=arm.name), python) as peer:
            seconds = float(np.median([peer.run(2)[1] / 2 for _ in range(rounds)])) / arm.steps
    except MissingPeer as missing:
        return Speed(arm.name, f"{_INSTALL} ({missing})")
    return Speed(arm.name, arm.what, 1 / seconds, arm.time_step / seconds)
