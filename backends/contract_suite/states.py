"""Make simulations, states, commands and parameters for the contract's tests, and compare states.

Everything is measured through the contract.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array, Dynamics, Simulation, Snapshot, State
from cdcsr.simulation.engines import load_backend, make_simulation
from cdcsr.simulation.plant import Parameters

KINDS = ("paper", "planar-single", "three-cable", "three-segment")
"""Shipped robots of every kind; the others are similar to these."""
STRETCH = 0.05e-3
"""A cable that is not soft may be longer than at rest by this, in [m]."""


class Make(Protocol):
    """Makes a simulation in the engine of a name; :func:`simulations` closes it."""

    def __call__(self, engine: str, robot: Robot, num: int = 1) -> Simulation: ...


@contextmanager
def running(robot: Robot, engine: str, num: int = 1) -> Iterator[Simulation]:
    """Yield a simulation that is closed at the end."""
    simulation = make_simulation(robot, engine, num)
    try:
        yield simulation
    finally:
        simulation.close()


@contextmanager
def simulations() -> Iterator[Make]:
    """Yield what makes simulations; all of them are closed at the end."""
    with ExitStack() as made:
        yield lambda engine, robot, num=1: made.enter_context(running(robot, engine, num))


def tolerance(engine: str) -> float:
    """Return how far two runs may differ that should be one: not at all if the engine is declared
    as bit-exact, else by 1e-10 over the steps made here, and by 1e-3 in single precision.

    PyBullet for example stores the base's pose in another form than it returns.
    """
    if "bit_exact" in load_backend(engine).capabilities:
        return 0.0
    return 1e-3 if rounding(engine) else 1e-10


def rounding(engine: str) -> float:
    """Return what single precision adds to the error of numbers of the size of one; zero for
    engines in double precision."""
    return 3e-6 if "single_precision" in load_backend(engine).capabilities else 0.0


def commands_of(robot: Robot, steps: int, num: int = 1, seed: int = 0, hold: int = 20) -> Array:
    """Return random commands, shape (steps, num, C), each held for some steps, so that the arm
    moves."""
    draws = (
        np.random.default_rng(seed).uniform(-1, 0, (-(-steps // hold), num, robot.num_cables))
        * -robot.full_commands
    )
    return np.repeat(draws, hold, axis=0)[:steps]


def at(robot: Robot, position: Array, velocity: Array) -> Snapshot:
    """Return a state as a snapshot that every engine takes."""
    num = len(position)
    return Snapshot(
        "by hand", robot.fingerprint, np.zeros(num), position, velocity, np.zeros((num, 0))
    )


def straight(robot: Robot, num: int = 1, travel: float = 0.0) -> Snapshot:
    """Return robots at rest and straight, all sliders at one travel; positive: all cables are
    slack."""
    position = np.zeros((num, 7 + robot.num_cables + robot.num_hinges))
    position[:, 3] = 1
    position[:, 7 : 7 + robot.num_cables] = travel
    return at(robot, position, np.zeros((num, robot.num_coordinates)))


def moving(robot: Robot, num: int, bend: float = 0.3, seed: int = 0) -> Snapshot:
    """Return turned, bent robots with every coordinate in motion; cables are slack, taut or too
    long."""
    rng, cables, hinges = np.random.default_rng(seed), robot.num_cables, robot.num_hinges
    turn = Rotation.random(num, rng=rng).as_quat(scalar_first=True)
    place = [rng.uniform(-1, 1, (num, 3)), turn, rng.uniform(-0.05, 0.05, (num, cables))]
    position = np.concatenate([*place, rng.uniform(-bend, bend, (num, hinges))], axis=1)
    return at(robot, position, rng.uniform(-1, 1, (num, robot.num_coordinates)))


def stretch(simulation: Simulation, tension: float) -> float:
    """Return how much longer than at rest a cable may be under a tension in [N], in [m].

    Soft cables are MuJoCo's limits at its default softness. By its documentation ("Solver
    parameters") a limit that is exceeded by x gives, at rest, the force

        T = k x d / ((1 - d) A),  k = d / (dmax² t²),  so  x = T A (1 - d) (dmax t / d)²,

    where t = 0.02 s is its time constant, A the inverse inertia of the straight robot along the
    tendon, L M^-1 L^T, and d the impedance: dmax = 0.95 where x is over 1 mm, and from 0.9 below.
    """
    if "soft_cables" not in simulation.capabilities:
        return STRETCH
    with running(simulation.robot, simulation.engine) as still:
        equation = still.dynamics()
    L, M = equation.cable_jacobian[0], equation.mass_matrix[0]
    largest = tension * np.diagonal(L @ np.linalg.solve(M, L.T)).max() * 0.02**2
    return STRETCH + max(largest * (1 - 0.95), min(largest * (1 - 0.9) * (0.95 / 0.9) ** 2, 1e-3))


def random_parameters(robot: Robot, num: int, seed: int = 0) -> Parameters:
    """Return parameters that differ for every part of every copy."""
    random = np.random.default_rng(seed)

    def factors(parts: int) -> Array:
        return random.uniform(0.7, 1.4, (num, parts))

    return Parameters(
        base_mass=factors(1)[:, 0],
        base_inertia=factors(1),
        link_mass=factors(robot.num_links),
        link_inertia=factors(robot.num_links),
        joint_stiffness=factors(robot.num_links),
        joint_damping=factors(robot.num_links),
        slider_damping=factors(robot.num_cables),
        servo_gain=factors(robot.num_cables),
        rest_length_offset=random.uniform(-0.002, 0.002, (num, robot.num_cables)),
    )


def assert_same(
    found: State | Dynamics | Snapshot,
    expected: State | Dynamics | Snapshot,
    copies: slice | list[int] = slice(None),
    rtol: float = 0.0,
    atol: float = 0.0,
) -> None:
    """Compare all arrays of some copies; of snapshots only time, position and velocity."""
    common = ("time", "position", "velocity")
    for name in common if isinstance(found, Snapshot) else [field.name for field in fields(found)]:
        one, other = getattr(found, name)[copies], getattr(expected, name)[copies]
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol, err_msg=name)
