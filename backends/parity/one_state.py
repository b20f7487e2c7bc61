"""Level 1: the equation of motion at random states, in every engine; the cables also in closed
form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from backends.parity.checks import Check, Engines, reference_of
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_jacobian, cable_lengths, routing
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Array, Dynamics, Snapshot


class Tolerance(NamedTuple):
    """How far two equations of motion may differ that should be one."""

    relative: float
    """The tolerance of matrices and forces."""
    length: float
    """The tolerance of cable lengths for the paper's robot, in [m]; it grows with the arm."""


DOUBLE, SINGLE = Tolerance(1e-10, 1e-9), Tolerance(1e-4, 3e-6)
"""The tolerances of engines that compute in double and in single precision."""
_BEND = 0.8
"""The largest hinge angle of a random state, as a part of the hinge's limit."""


def random_states(robot: Robot, num: int, seed: int) -> Snapshot:
    """Return robots turned and bent at random, with every coordinate in motion and about half of
    the cables slack. A fixed base stays as it is: engines read no motion of it.

    It is a snapshot of no engine, so that each reads only positions and velocities from it.
    """
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=(num, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    lower, upper = np.array([(hinge.lower, hinge.upper) for hinge in robot.hinges]).T
    part = rng.uniform(-1, 1, (num, robot.num_hinges))
    hinges = _BEND * np.where(part > 0, upper, -lower) * part
    route = routing(robot)
    # A slider at minus its cable's excess length makes the cable just taut; shifted from there, the
    # cable is too long or slack.
    excess = cable_lengths(route, np.zeros((num, robot.num_cables)), hinges) - route.rest_length
    shift = 0.1 * route.slider_offset * rng.uniform(-1, 1, (num, robot.num_cables))
    travel = np.minimum(excess + shift, 0.5 * route.slider_offset)
    position = np.concatenate([rng.uniform(-1, 1, (num, 3)), quaternion, travel, hinges], axis=1)
    velocity = rng.uniform(-1, 1, (num, robot.num_coordinates))
    return Snapshot("", robot.fingerprint, np.zeros(num), position, velocity, np.zeros((num, 0)))


def one_state(robot: Robot, engines: Engines, num: int = 16, seed: int = 0) -> list[Check]:
    """Compare every engine's equation of motion with the reference's, and every engine's cables
    with the closed form."""
    states = random_states(robot, num, seed)
    found: dict[str, Dynamics] = {}
    near: dict[str, Tolerance] = {}
    for name, make in engines.items():
        simulation = make(robot, num)
        simulation.set_snapshot(states)
        found[name] = simulation.dynamics()
        near[name] = SINGLE if "single_precision" in simulation.capabilities else DOUBLE
        simulation.close()
    reference = reference_of(engines)
    checks = []
    for name, dynamics in found.items():
        if name != reference:
            tolerance, pair = max(near[name], near[reference]), f"{name} - {reference}"
            checks += list(compare(robot, dynamics, found[reference], pair, tolerance))
    for name, dynamics in found.items():
        pair = f"{name} - closed form"
        checks += list(_compare_cables(robot, dynamics, states, pair, near[name]))
    return checks


def compare(
    robot: Robot, one: Dynamics, other: Dynamics, pair: str, near: Tolerance = DOUBLE
) -> Iterator[Check]:
    """Compare two equations of motion at the same states, of which `other` is the reference."""
    names = coordinate_names(robot)
    diagonal = np.sqrt(np.diagonal(other.mass_matrix, axis1=1, axis2=2))
    scale = diagonal[:, :, None] * diagonal[:, None, :]
    difference = (one.mass_matrix - other.mass_matrix) / scale
    yield _worst("mass matrix", pair, difference, near.relative, "relative", [names, names])

    tip, expected = generalized_tip_jacobian(one), generalized_tip_jacobian(other)
    difference, axes = _by_column(tip - expected, expected), [["x", "y", "z"], names[6:]]
    yield _worst("generalized tip Jacobian", pair, difference, near.relative, "relative", axes)

    for label, ours, theirs in (
        ("bias force", one.bias_force, other.bias_force),
        ("passive force", one.passive_force, other.passive_force),
    ):
        difference = (ours - theirs) / np.abs(theirs).max(axis=1, keepdims=True)
        yield _worst(label, pair, difference, near.relative, "relative", [names])

    cables = cable_names(robot)
    difference = one.cable_length - other.cable_length
    yield _worst("cable length", pair, difference, near.length * ruler(robot).size, "m", [cables])
    difference = _by_column(one.cable_jacobian - other.cable_jacobian, other.cable_jacobian)
    yield _worst("cable Jacobian", pair, difference, near.relative, "relative", [cables, names])


def generalized_tip_jacobian(dynamics: Dynamics) -> Array:
    """Return the generalized Jacobian of a free-floating robot (Umetani and Yoshida, 1989).

    It is the tip velocity for each slider and hinge rate while the momentum is zero, so that the
    base gives way to the arm: M_bb v_base + M_bj v_joints = 0.

    Returns:
        Shape (n, 3, C + H).
    """
    mass, tip = dynamics.mass_matrix, dynamics.tip_jacobian
    return tip[:, :, 6:] - tip[:, :, :6] @ np.linalg.solve(mass[:, :6, :6], mass[:, :6, 6:])


def coordinate_names(robot: Robot) -> list[str]:
    """Return the names of the coordinates in the contract's order."""
    base = [f"base {kind} {axis}" for kind in ("linear", "angular") for axis in "xyz"]
    hinges = [
        f"hinge_{j}_{hinge.axis}"
        for j, hinge in zip(robot.link_of_hinge, robot.hinges, strict=True)
    ]
    return base + [f"slide_{c}" for c in range(robot.num_cables)] + hinges


def cable_names(robot: Robot) -> list[str]:
    """Return the names of the cables in their order."""
    return [f"cable_{c}" for c in range(robot.num_cables)]


def _compare_cables(
    robot: Robot, dynamics: Dynamics, states: Snapshot, pair: str, near: Tolerance
) -> Iterator[Check]:
    route, joints = routing(robot), states.position[:, 7:]
    travel, hinges = joints[:, : robot.num_cables], joints[:, robot.num_cables :]
    names, cables = coordinate_names(robot), cable_names(robot)
    difference = dynamics.cable_length - cable_lengths(route, travel, hinges)
    yield _worst("cable length", pair, difference, near.length * ruler(robot).size, "m", [cables])
    exact = np.zeros_like(dynamics.cable_jacobian)
    exact[:, :, 6:] = cable_jacobian(route, travel, hinges)
    difference = _by_column(dynamics.cable_jacobian - exact, exact)
    yield _worst("cable Jacobian", pair, difference, near.relative, "relative", [cables, names])


def _by_column(difference: Array, reference: Array) -> Array:
    """Divide differences by the largest entry of their column, because columns differ in unit.

    If a column is zero but for rounding, as the base's is for cables, its differences are divided
    by the largest entry of the whole matrix.
    """
    column = np.abs(reference).max(axis=1, keepdims=True)
    whole = column.max(axis=2, keepdims=True)
    return difference / np.where(column > 1e-9 * whole, column, whole)


def _worst(
    name: str,
    pair: str,
    difference: Array,
    tolerance: float,
    unit: str,
    axes: Sequence[Sequence[str]],
) -> Check:
    """Make the check of the largest difference.

    Args:
        name: the quantity.
        pair: what is compared.
        difference: shape (n, ...).
        tolerance: its tolerance.
        unit: its unit.
        axes: the names along each axis but the first; they tell where the largest difference is.
    """
    size = np.where(np.isnan(difference), np.inf, np.abs(difference))
    _, *place = np.unravel_index(int(size.argmax()), size.shape)
    labels = dict.fromkeys(names[int(i)] for names, i in zip(axes, place, strict=True))
    where = ", ".join(labels) if size.any() else ""
    return Check(1, name, pair, float(size.max()), tolerance, unit, where)
