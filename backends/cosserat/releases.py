"""Rods of links that are held by wrenches and let go, held against a continuous rod over time."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backends.cosserat.equilibrium import equilibrium
from backends.cosserat.reference import Release, Shapes
from backends.cosserat.statics import load, places
from cdcsr.errors import CdcsrWarning
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters

STACKED = "mujoco-stock:softness=description,integrator=implicitfast"
"""The engine of a stacked rod: MuJoCo with nothing added."""


@dataclass(frozen=True)
class Swing:
    """How a released rod of links moves beside the continuous one."""

    tip: Array
    """Place of the tip from the clamp at the times of the release, shape (T, 3), in [m]."""
    distance: Array
    """Distance from the continuous rod's tip, shape (T,), in [m]."""

    @property
    def rms(self) -> float:
        """The root mean square distance in [m]."""
        return float(np.sqrt(np.mean(self.distance**2)))


def swings(releases: Sequence[Release], robot: Robot, engine: str) -> list[Swing]:
    """Release copies of a rod: each starts where it rests under its wrenches and its gravity, and
    keeps gravity.

    Args:
        releases: of one material, equally long.
        robot: the rod.
        engine: in which the rod moves.
    """
    with warnings.catch_warnings():  # implicit dampers are stable below 4 damping times
        warnings.simplefilter("ignore", CdcsrWarning)
        simulation = make_simulation(robot, engine, len(releases))
    try:
        ratio = robot.hinges[0].damping / robot.hinges[0].stiffness
        damping = np.array([release.damping_time for release in releases]) / ratio
        simulation.set_parameters(None, Parameters(joint_damping=damping))
        load(simulation, held(releases))
        tips = [places(simulation, equilibrium(simulation))[:, 1]]
        for link in range(robot.num_links):
            for slot in (0, 2):  # slot 1 is the weight
                simulation.set_loads(None, link, slot=slot)
        substeps = round(releases[0].interval / robot.time_step)
        command = np.zeros((len(releases), 0))
        for _ in releases[0].tip[1:]:
            simulation.step(command, substeps)
            tips.append(places(simulation, simulation.state().joint_angles)[:, 1])
    finally:
        simulation.close()
    return [
        Swing(tip, np.linalg.norm(tip - release.tip, axis=1))
        for tip, release in zip(np.stack(tips, axis=1), releases, strict=True)
    ]


def held(releases: Sequence[Release]) -> Shapes:
    """Return the shapes at rest from which rods are released, without the place of the middle."""
    gravity = np.array([release.gravity for release in releases])
    middle, tip = (np.array([release.wrenches[k] for release in releases]) for k in (0, 1))
    start = np.array([release.tip[0] for release in releases])
    return Shapes(gravity, middle, tip, np.stack([np.full_like(start, np.nan), start], axis=1))
