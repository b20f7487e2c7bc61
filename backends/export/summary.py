"""A summary of a robot in numbers, and how far the engines agree on its mass matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypedDict

import numpy as np

from backends.parity.open_loop import accuracy, accurate_step
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import tip_at_start
from cdcsr.robot.routing import routing
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import engine_factory, make_simulation
from cdcsr.simulation.rotations import at_start

_BEND = 0.3
"""The largest hinge angle of the bent state, in [rad]; less where the hinge's limit is smaller."""


class Cable(TypedDict):
    """A cable of a summary."""

    name: str
    segment: int
    rest_length: float
    """[m]"""


class MassDifference(TypedDict):
    """The largest difference of an entry M_ij of two mass matrices, relative to sqrt(M_ii M_jj)."""

    straight: float
    bent: float
    """In one random state."""


class Summary(TypedDict):
    """The robot in numbers, ready for JSON."""

    robot: str
    fingerprint: str
    bodies: int
    degrees_of_freedom: int
    total_mass: float
    """[kg]"""
    center_of_mass: list[float]
    """The centre of mass of the straight robot at the start, three numbers in [m], world frame."""
    tip: list[float]
    """Where the tip is at the start, three numbers in [m], world frame."""
    reach: float
    """From the first joint to the tip of the straight arm, in [m]."""
    cables: list[Cable]
    backends: list[str]
    time_step: float
    """[s]"""
    stable_step: float
    """The largest time step in [s] below which no spring shakes."""
    accuracy: float
    """A tenth of the tasks' threshold, in [m]."""
    accurate_step: dict[str, float | None]
    """By engine, the time step in [s] at which the tip's mean error is `accuracy`; None if the
    engine diverges at `time_step`."""
    mass_matrix_difference: dict[str, MassDifference]
    """Every engine but the first, compared with the first."""


def summarize(robot: Robot, backends: Sequence[str]) -> Summary:
    """Summarize a robot, and compare its mass matrix in some engines."""
    error = accuracy(robot)
    route, top = routing(robot), robot.top + robot.arm_length
    segments = [s for s, segment in enumerate(robot.segments) for _ in segment.cable_angles]
    return {
        "robot": robot.name,
        "fingerprint": robot.fingerprint,
        "bodies": 1 + robot.num_cables + robot.num_links,
        "degrees_of_freedom": robot.num_coordinates - 6 * (robot.base.mount == "fixed"),
        "total_mass": robot.total_mass,
        "center_of_mass": (at_start(robot, _center_of_mass(robot)).round(12) + 0.0).tolist(),
        "tip": (tip_at_start(robot).round(12) + 0.0).tolist(),
        "reach": top - robot.first_joint,
        "cables": [
            {"name": f"cable_{c}", "segment": s, "rest_length": float(route.rest_length[c])}
            for c, s in enumerate(segments)
        ],
        "backends": list(backends),
        "time_step": robot.time_step,
        "stable_step": stable_step(robot),
        "accuracy": error,
        "accurate_step": {
            name: accurate_step(robot, engine_factory(name), error) for name in backends
        },
        "mass_matrix_difference": _mass_matrix_differences(robot, backends),
    }


def show(summary: Summary) -> str:
    """Return a summary as text to read."""
    cables = summary["cables"]
    x, y, z = summary["center_of_mass"]
    tip = ", ".join(f"{place:.6g}" for place in summary["tip"])
    lines = [
        f"robot               {summary['robot']} ({summary['fingerprint']})",
        f"bodies              {summary['bodies']}",
        f"degrees of freedom  {summary['degrees_of_freedom']}",
        f"total mass          {summary['total_mass']:.6g} kg",
        f"centre of mass      ({x:.6g}, {y:.6g}, {z:.6g}) m, straight",
        f"tip                 ({tip}) m; straight, {summary['reach']:.6g} m from the first joint",
        f"cables              {len(cables)}, rest lengths in m:",
    ]
    for s in sorted({cable["segment"] for cable in cables}):
        lengths = [f"{cable['rest_length']:.6g}" for cable in cables if cable["segment"] == s]
        lines.append(f"  segment {s}         {', '.join(lengths)}")
    lines.append(
        f"time step           {summary['time_step']:g} s; no spring shakes below "
        f"{summary['stable_step']:.2g} s"
    )
    for backend, step in summary["accurate_step"].items():
        said = f"{step:.2g} s" if step else "the robot's own step, at which it diverges"
        error = 1e3 * summary["accuracy"]
        lines.append(f"                    {backend} has a mean error of {error:g} mm at {said}")
    first = summary["backends"][0]
    for backend, difference in summary["mass_matrix_difference"].items():
        lines.append(
            f"mass matrix         {backend} differs from {first} by "
            f"{difference['straight']:.1e} straight, {difference['bent']:.1e} bent "
            "(largest relative difference)"
        )
    return "\n".join(lines)


def _center_of_mass(robot: Robot) -> Array:
    """Return the centre of mass of the straight robot, shape (3,), in [m], in the base's frame."""
    route = routing(robot)
    moment, height = np.zeros(3), robot.first_joint
    for link, _ in robot.links:
        moment[2] += link.mass * (height + link.center_of_mass)
        height += link.length
    for servo, place, offset in zip(
        robot.servos, route.place, route.guide_offset + route.slider_offset, strict=True
    ):
        moment += servo.mass * np.array([*place, robot.first_joint - offset])
    return moment / robot.total_mass


def _mass_matrix_differences(robot: Robot, backends: Sequence[str]) -> dict[str, MassDifference]:
    if len(backends) < 2:
        return {}
    matrices = {backend: _mass_matrices(robot, backend) for backend in backends}
    first = matrices.pop(backends[0])
    diagonal = np.sqrt(np.diagonal(first, axis1=1, axis2=2))
    scale = diagonal[:, :, None] * diagonal[:, None, :]
    differences = {
        backend: (np.abs(other - first) / scale).max(axis=(1, 2))
        for backend, other in matrices.items()
    }
    return {name: {"straight": float(d[0]), "bent": float(d[1])} for name, d in differences.items()}


def _mass_matrices(robot: Robot, backend: str) -> Array:
    """Return the mass matrices of two copies, shape (2, nv, nv): one is straight, one is bent and
    its base is turned."""
    random = np.random.default_rng(0)
    lower = max([-_BEND, *(hinge.lower for hinge in robot.hinges)])
    upper = min([_BEND, *(hinge.upper for hinge in robot.hinges)])
    quaternion = random.normal(size=4)
    bent = [
        random.uniform(-1, 1, 3),
        quaternion / np.linalg.norm(quaternion),
        -0.1 * np.array([servo.offset for servo in robot.servos]),
        random.uniform(lower, upper, robot.num_hinges),
    ]
    simulation = make_simulation(robot, backend, num=2)
    try:
        start = simulation.get_snapshot()
        position = np.stack([start.position[0], np.concatenate(bent)])
        # It is a snapshot of no engine, so that each reads only positions and velocities from it.
        simulation.set_snapshot(replace(start, engine="", position=position))
        return simulation.dynamics().mass_matrix
    finally:
        simulation.close()
