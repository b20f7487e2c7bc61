"""Where an arm without cables rests under its loads, by Newton's method on an engine's forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import Arms, arms
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.rotations import rotation_matrix

_STEP = 0.6
"""The largest change of a rod's total bend in one step, in [rad]: the sum of a hinge's change and
of those below it, about each axis."""
_ITERATIONS = 100
_TOLERANCE = 1e-9
"""An arm rests when no hinge feels more than this share of the largest moment of its springs."""


def equilibrium(simulation: Simulation) -> Array:
    """Put every copy where it rests under its loads, from where it is now, and return the angles.

    The forces are those of the engine's own equation of motion; only the direction of Newton's
    steps comes from a formula (:func:`_slope`).

    Args:
        simulation: of a robot with a fixed base and without cables.

    Returns:
        The hinge angles, shape (num, H), in [rad].

    Raises:
        CdcsrError: the robot has cables or a free base, or no rest is found.
    """
    robot = simulation.robot
    if robot.num_cables or robot.base.mount == "free":
        raise CdcsrError("Only an arm without cables on a fixed base has a rest to be found here.")
    position, still = simulation.get_snapshot().position, np.zeros(robot.num_coordinates)
    turn = rotation_matrix(np.array(robot.base.quaternion))
    moving = np.arange(simulation.num)
    for _ in range(_ITERATIONS):
        simulation.place(moving, position[moving], np.tile(still, (len(moving), 1)))
        equation = simulation.dynamics(moving)
        force = (equation.passive_force - equation.bias_force)[:, 6:]
        spring = np.abs(simulation.plant.stiffness[moving] * position[moving, 7:]).max(axis=1)
        rests = np.abs(force).max(axis=1) <= _TOLERANCE * spring
        moving, force = moving[~rests], force[~rests]
        if len(moving) == 0:
            return position[:, 7:]
        slope = _slope(simulation, moving, arms(robot, position[moving, 7:]), turn)
        step: Array = np.linalg.solve(slope, -force[..., None])[..., 0].astype(np.float64)
        step *= np.minimum(1, _STEP / np.maximum(_total_bend(robot, step), 1e-12))[:, None]
        position[moving, 7:] += step
    raise CdcsrError(
        f"After {_ITERATIONS} steps of Newton's method {len(moving)} of {simulation.num} arms do "
        "not rest; start closer to the rest, or use smaller loads."
    )


def _total_bend(robot: Robot, step: Array) -> Array:
    """Return the largest sum of changes along the arm about one axis, shape (num,), in [rad]."""
    axes = np.array([hinge.axis for hinge in robot.hinges])
    sums = [np.abs(np.cumsum(step[:, axes == axis], axis=1)).max(axis=1) for axis in set(axes)]
    return np.max(sums, axis=0)


def _slope(simulation: Simulation, ids: NDArray[np.int64], where: Arms, turn: Array) -> Array:
    """Return the derivatives of the hinges' forces with respect to the angles, (n, H, H).

    Link k carries the force F_k at x_k and the torque T_k, all fixed in the world, and hinge i has
    the axis a_i through p_i. Its moment is a_i . N_i with N_i = sum of (x_k - p_i) x F_k + T_k over
    the links beyond it. If hinge j turns, all beyond it turns about a_j; with the sum over the
    links beyond the further one of both hinges, at m = max(i, j),

        d(moment_i) / d(q_j) = a_i . G_m a_j  + (a_j x a_i) . N_i   (the last only if j < i)
        G_m = sum of r F^T - (r . F) 1,   r = x_k - p_m,

    because (a x r) x F = r (a . F) - a (r . F).
    """
    robot, loads = simulation.robot, simulation.loads
    loaded, twisted, point = (x[ids] for x in (loads.force, loads.torque, loads.point))
    axis = np.einsum("ab,nhb->nha", turn, where.axis)
    turns = np.einsum("ab,njbc->njac", turn, where.turn)
    joint = np.einsum("ab,njb->nja", turn, where.joint)
    centers = np.array([[0, 0, link.center_of_mass] for link, _ in robot.links])
    center = joint[:, :-1] + np.einsum("njab,jb->nja", turns, centers)
    weight = simulation.plant.link_mass[ids][..., None] * np.array(robot.gravity)
    place = center[:, :, None] + np.einsum("njab,njsb->njsa", turns, point)
    # Sums over the links from each one to the tip, about the base.
    total = _beyond(loaded.sum(axis=2) + weight)
    outer = _beyond(
        np.einsum("njsa,njsb->njab", place, loaded) + np.einsum("nja,njb->njab", center, weight)
    )
    moment = _beyond((twisted + np.cross(place, loaded)).sum(axis=2) + np.cross(center, weight))
    link = np.array(robot.link_of_hinge)
    total, at = total[:, link], joint[:, link]
    moment = moment[:, link] - np.cross(at, total)
    outer = outer[:, link] - np.einsum("nha,nhb->nhab", at, total)
    lever = outer - np.einsum("nhaa->nh", outer)[..., None, None] * np.eye(3)
    further_j = axis @ np.einsum("njab,njb->nja", lever, axis).swapaxes(1, 2)
    further_i = np.einsum("niab,nia->nib", lever, axis) + np.cross(axis, moment)
    slope = np.triu(further_j) + np.tril(further_i @ axis.swapaxes(1, 2), -1)
    diagonal = np.arange(robot.num_hinges)
    slope[:, diagonal, diagonal] -= simulation.plant.stiffness[ids]
    return slope


def _beyond(values: Array) -> Array:
    """Return the sums over the links from each one to the tip, along axis 1."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1]
