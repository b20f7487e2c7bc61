"""Shapes at rest of a rod of links, held against those of a continuous rod."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import numpy as np

from backends.cosserat.equilibrium import equilibrium
from backends.cosserat.reference import Shapes, rod
from cdcsr.errors import CdcsrWarning
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import arms
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.engines import make_simulation


@dataclass(frozen=True)
class Fit:
    """How far a rod of some number of links is from the continuous one; n shapes."""

    links: int
    tip: Array
    """Place of the tip from the clamp, shape (n, 3), in [m]."""
    tip_error: Array
    """Distance of the tips, shape (n,), in [m]."""
    middle_error: Array
    """Distance of the middles, shape (n,), in [m]."""
    seconds: float
    """For one shape: loading the rod and finding its rest."""


def fit(material: str, links: int, shapes: Shapes, engine: str) -> Fit:
    """Find the rest of a rod of links under the loads of every shape."""
    robot = rod(material, links)
    with warnings.catch_warnings():  # nothing is stepped, so no step is too large
        warnings.simplefilter("ignore", CdcsrWarning)
        simulation = make_simulation(robot, engine, len(shapes.gravity))
    try:
        start = time.perf_counter()
        load(simulation, shapes)
        place = places(simulation, equilibrium(simulation))
        seconds = (time.perf_counter() - start) / simulation.num
    finally:
        simulation.close()
    error = np.linalg.norm(place - shapes.place, axis=-1)
    return Fit(links, place[:, 1], error[:, 1], error[:, 0], seconds)


def load(simulation: Simulation, shapes: Shapes) -> None:
    """Load every copy of a rod with gravity and the wrenches of one shape.

    Where half of the length is a joint, the links on both sides carry half of the wrench each.
    """
    links = [link for link, _ in simulation.robot.links]
    for number, link in enumerate(links):
        simulation.set_loads(None, number, force=link.mass * shapes.gravity, slot=1)
    torque, force = shapes.tip[:, :3], shapes.tip[:, 3:]
    simulation.set_loads(None, -1, force, torque, (0, 0, links[-1].length), slot=2)
    torque, force = shapes.middle[:, :3], shapes.middle[:, 3:]
    lower, height = _middle(simulation.robot)
    if height is not None:
        simulation.set_loads(None, lower, force, torque, (0, 0, height))
        return
    simulation.set_loads(None, lower + 1, force / 2, torque / 2, (0, 0, 0))
    if lower >= 0:
        simulation.set_loads(None, lower, force / 2, torque / 2, (0, 0, links[lower].length))


def places(simulation: Simulation, angles: Array) -> Array:
    """Return the places of middle and tip, from the clamp, shape (n, 2, 3), in [m]."""
    robot = simulation.robot
    where = arms(robot, angles)
    lower, height = _middle(robot)
    middle = where.joint[:, lower + 1]
    if height is not None:
        middle = where.joint[:, lower] + height * where.turn[:, lower, :, 2]
    return np.stack([middle, where.joint[:, -1]], axis=1) - (0, 0, robot.top)


def _middle(robot: Robot) -> tuple[int, float | None]:
    """Return where half of a rod's length is: the link, and the height above its joint; None if it
    is the joint above the link, and link -1 is the part below the first joint."""
    joints = (
        robot.first_joint - robot.top + np.cumsum([0.0, *(link.length for link, _ in robot.links)])
    )
    half = robot.arm_length / 2
    above = int(np.argmin(np.abs(joints - half)))
    if abs(joints[above] - half) < 1e-6 * robot.arm_length:
        return above - 1, None
    link = int(np.searchsorted(joints, half)) - 1
    return link, float(half - joints[link])


def order(material: str, divisions: tuple[int, int, int], shapes: Shapes, engine: str) -> float:
    """Return the order p with which the mean tip error falls in the number of links, 1 / N^p.

    The rod is compared with itself, so that the rounding of the data has no part in it: from N to
    3 N links the tip moves 3^p times as far as from 3 N to 9 N.

    Args:
        material: the rod's.
        divisions: N, 3 N and 9 N.
        shapes: their loads.
        engine: whose forces must balance.
    """
    coarse, fine, finest = (fit(material, n, shapes, engine).tip for n in divisions)
    moves = [np.linalg.norm(b - a, axis=1).mean() for a, b in ((coarse, fine), (fine, finest))]
    return float(np.log(moves[0] / moves[1]) / np.log(3))
