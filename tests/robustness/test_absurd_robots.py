"""Robots that are allowed and cannot be meant: each run is right, warned of, or has diverged."""

from __future__ import annotations

import math
import warnings
from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from backends.contract_suite.states import KINDS
from cdcsr.errors import CdcsrWarning, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import make_simulation

ENGINES = ("mujoco", "pybullet")
SECONDS = 0.25
MOST_STEPS = 400
"""Robots with a tiny time step are simulated for so many of them only."""
FINE = 16
"""How many times smaller the smallest step is than the robot's own."""
TOLERANCE = 1e-3
"""A difference between engines that nobody is told of, in [m]."""
ORDER = 4.0
"""The motion between two steps, halved, may still be this many times farther from its limit than
they are apart; at first order in the step it would be once."""


def absurd(rng: np.random.Generator) -> Robot:
    """Return a shipped robot with one to three numbers wrong by up to a factor of 1000.

    Raises:
        ValidationError: such a robot is refused.
    """
    data = load_robot(KINDS[rng.integers(len(KINDS))]).model_dump()
    segment = data["segments"][rng.integers(len(data["segments"]))]
    places = [(segment["link"], "mass"), (segment["joint"], "stiffness"), (data["base"], "mass")]
    places += [(segment["joint"], "damping"), (segment["servo"], "gain"), (data, "time_step")]
    places += [
        (segment["servo"], "mass"),
        (segment["servo"], "damping"),
        (segment["link"], "radius"),
    ]
    places += [(segment["joint"], "limit"), (segment["cables"], "pitch_radius")]
    for at in rng.choice(len(places), rng.integers(1, 4), replace=False):
        section, key = places[at]
        if section[key] is not None:
            section[key] *= 10 ** rng.uniform(-3, 3)
    Robot.model_validate(data | {"time_step": data["time_step"] / FINE})
    return Robot.model_validate(data)


def tips(
    robot: Robot, engine: str, divide: int, command: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Return the tip after some time under a held command, and whether a warning was given.

    Raises:
        Diverged: the simulation says so.
    """
    fine = Robot.model_validate(robot.model_dump() | {"time_step": robot.time_step / divide})
    steps = min(MOST_STEPS, math.ceil(SECONDS / robot.time_step)) * divide
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CdcsrWarning)
        simulation = make_simulation(fine, engine)
    try:
        simulation.step(command, steps)
        return simulation.state().tip_position[0], bool(caught)
    finally:
        simulation.close()


def outcome(robot: Robot, rng: np.random.Generator) -> str:
    """Run a robot in both engines with three steps each, and return what came of it."""
    eta = np.array([servo.eta for servo in robot.servos])
    command = -rng.random((1, robot.num_cables)) * eta / 2
    found: dict[str, list[NDArray[np.float64]]] = {}
    try:
        for engine in ENGINES:
            runs = [tips(robot, engine, divide, command) for divide in (1, FINE // 2, FINE)]
            if runs[0][1]:
                return "warned"
            found[engine] = [tip for tip, _ in runs]
    except Diverged:
        return "diverged"
    gap = float(np.linalg.norm(found["mujoco"][-1] - found["pybullet"][-1]))
    left = sum(float(np.linalg.norm(one[-1] - one[-2])) for one in found.values())
    return "right" if gap <= TOLERANCE + ORDER * left else f"silent: {1e3 * gap:.2f} mm"


def campaign(runs: int, seed: int) -> Counter[str]:
    """Count what becomes of absurd robots; those that are refused are drawn anew."""
    rng = np.random.default_rng(seed)
    counts: Counter[str] = Counter()
    while counts.total() - counts["refused"] < runs:
        try:
            robot = absurd(rng)
        except ValidationError:
            counts["refused"] += 1
            continue
        what = outcome(robot, rng)
        if what.startswith("silent"):
            print(what, robot.to_toml())
        counts[what] += 1
    print(dict(counts))
    return counts


def test_no_absurd_robot_differs_between_engines_without_a_word() -> None:
    assert set(campaign(8, 1)) <= {"right", "warned", "diverged", "refused"}


@pytest.mark.slow
def test_no_absurd_robot_of_500_runs_differs_between_engines_without_a_word() -> None:
    assert set(campaign(250, 0)) <= {"right", "warned", "diverged", "refused"}
