"""Shapes at rest of a rod of links, held against those of a continuous rod."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import numpy as np

from backends.cosserat.equilibrium import equilibrium
from backends.cosserat.reference import Shapes, rod
from cdcsr.errors import CdcsrWarning
from cdcsr.robot.poses import arms
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.engines import make_simulation


@dataclass(frozen=True)
class Fit:
    """How far a rod of some number of links is from the continuous one; n shapes."""

    links: int
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
    return Fit(links, error[:, 1], error[:, 0], seconds)


def load(simulation: Simulation, shapes: Shapes) -> None:
    """Load every copy of a rod with gravity and the wrenches of one shape.

    Half of the length is the middle of a link if their number is even. If it is odd, it is a joint,
    and the links on both sides of it carry half of the wrench each.
    """
    links = [link for link, _ in simulation.robot.links]
    for number, link in enumerate(links):
        simulation.set_loads(None, number, force=link.mass * shapes.gravity, slot=1)
    torque, force = shapes.tip[:, :3], shapes.tip[:, 3:]
    simulation.set_loads(None, -1, force, torque, (0, 0, links[-1].length), slot=2)
    torque, force = shapes.middle[:, :3], shapes.middle[:, 3:]
    lower, height = _middle(simulation)
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
    lower, height = _middle(simulation)
    middle = where.joint[:, lower + 1]
    if height is not None:
        middle = where.joint[:, lower] + height * where.turn[:, lower, :, 2]
    return np.stack([middle, where.joint[:, -1]], axis=1) - (0, 0, robot.top)


def _middle(simulation: Simulation) -> tuple[int, float | None]:
    """Return where the middle of a rod of equal cells is: the link, and the height above its joint;
    None if it is the joint above the link."""
    cells = simulation.robot.num_links
    if cells % 2:
        return cells // 2 - 1, None
    return cells // 2 - 1, simulation.robot.arm_length / cells / 2
