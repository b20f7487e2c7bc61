"""Cables and hinge limits as unilateral constraints, compiled: the joint forces for PyBullet.

PyBullet's multibodies know no tendon, rope or distance limit. So each step first solves for the
acceleration a that the robot will have, with dampers taken implicitly and springs and servos where
the step begins,

    (M + h C) a = f - bias - L^T t,    f = -K q - C v + servo forces,

where the tensions t are the multipliers of the unilateral constraints: a cable that is slack may at
most become taut within the step, and one that is too long takes its excess back with the recovery
time,

    0 <= t   complementary to   L (v + h a) <= gap / (h if gap >= 0 else recovery_time).

A hinge limit is one more row of the same kind. PyBullet, which is explicit, reaches just this
acceleration under the joint forces f - h C a - L^T t. The base's rows of them are zero: nothing
pushes from outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from backends.pybullet.dynamics import Chain, bias_force, forward_kinematics, mass_matrix, own_chain
from backends.pybullet.lcp import append_row, factor, solve_complementarity, solve_transposed
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import crossing, routing
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]

_crossing = numba.njit(cache=True)(crossing)


class Rig(NamedTuple):
    """Cables, servos and hinges as plain arrays (C cables, J joints), and the two times."""

    place: Array
    """(C, 2) across the arm in [m]."""
    guide_offset: Array
    """(C,) [m]."""
    joints: NDArray[np.int64]
    """(C,) how many joints each cable crosses."""
    slider_offset: Array
    """(C,) [m]."""
    rest_length_offset: Array
    """(C,) how much longer each cable is than the description's, in [m]."""
    gain: Array
    """(C,) of the servos in [N/m]."""
    stiffness: Array
    """(2 J,) [N m/rad]."""
    damping: Array
    """(C + 2 J,) of sliders [N s/m] and hinges [N m s/rad]."""
    limit: Array
    """(2 J,) [rad]."""
    time_step: float
    """[s]."""
    recovery_time: float
    """[s]."""


def rig(robot: Robot) -> Rig:
    """The numbers of a robot that its joint forces need."""
    route = routing(robot)
    hinges = [joint for _, joint in robot.links for _ in range(2)]
    return Rig(
        place=route.place,
        guide_offset=route.guide_offset,
        joints=route.joints,
        slider_offset=route.slider_offset,
        rest_length_offset=np.zeros(robot.num_cables),
        gain=np.array([servo.gain for servo in robot.servos]),
        stiffness=np.array([joint.stiffness for joint in hinges]),
        damping=np.array(
            [servo.damping for servo in robot.servos] + [joint.damping for joint in hinges]
        ),
        limit=np.array([joint.limit for joint in hinges]),
        time_step=robot.time_step,
        recovery_time=robot.constraint.recovery_time,
    )


@numba.njit(cache=True)
def own_rig(rig: Rig, plant: Plant, row: int) -> Rig:
    """The numbers of one copy: from a row of `plant` what it has, all else from the description."""
    return Rig(
        rig.place,
        rig.guide_offset,
        rig.joints,
        rig.slider_offset,
        plant.rest_length_offset[row],
        plant.servo_gain[row],
        plant.stiffness[row],
        plant.damping[row],
        rig.limit,
        rig.time_step,
        rig.recovery_time,
    )


@numba.njit(cache=True)
def cable_rows(
    rig: Rig, travel: Array, sine: Array, cosine: Array, by_slider: Array, by_hinge: Array
) -> Array:
    """Return the gap of every cable, shape (C,), and fill in the derivatives of the lengths, shapes
    (C,) and (C, 2 J)."""
    gap = np.empty(travel.size)
    for c in range(travel.size):
        px, py, offset = rig.place[c, 0], rig.place[c, 1], rig.guide_offset[c]
        below = rig.slider_offset[c] - travel[c]
        by_slider[c] = -np.sign(below)
        excess = abs(below) - rig.slider_offset[c]
        for n in range(rig.joints[c]):
            x, y = 2 * n, 2 * n + 1
            length, by_x, by_y = _crossing(sine[x], cosine[x], sine[y], cosine[y], px, py, offset)
            excess += length - 2 * offset
            by_hinge[c, x], by_hinge[c, y] = by_x, by_y
        gap[c] = rig.rest_length_offset[c] - excess
    return gap


@numba.njit(cache=True)
def _slack_rate(gap: float, rig: Rig) -> float:
    """The fastest that a gap may close."""
    return gap / (rig.time_step if gap >= 0 else rig.recovery_time)


@numba.njit(cache=True)
def _joint_forces(
    chain: Chain, rig: Rig, position: Array, velocity: Array, command: Array, tension: Array
) -> Array:
    """Return the forces on sliders and hinges of one copy, shape (C + 2 J,); update the tensions.

    The factorised matrix is of the hinges, then the base; sliders touch nothing but the base and
    are eliminated beforehand. Rows appended to the factor are the constraints' whitened directions,
    so their products are the complementarity problem's matrix.
    """
    num_cables, num_hinges = rig.gain.size, rig.limit.size
    first, size, step = 6 + num_cables, num_hinges + 6, rig.time_step
    frames = forward_kinematics(chain, position)
    mass = mass_matrix(chain, frames)
    travel, hinges = position[7 : 7 + num_cables], position[7 + num_cables :]

    force = np.empty(num_cables + num_hinges)
    for c in range(num_cables):
        force[c] = rig.gain[c] * (command[c] - travel[c]) - rig.damping[c] * velocity[6 + c]
    for k in range(num_hinges):
        damping = rig.damping[num_cables + k]
        force[num_cables + k] = -rig.stiffness[k] * hinges[k] - damping * velocity[first + k]
    load = -bias_force(chain, frames, velocity)
    load[6:] += force

    # Rows of `whole`: the factor (size), what drives (1), cables (C), hinge limits (as many as are
    # met).
    whole = np.zeros((size + 1 + num_cables + num_hinges, size))
    heft = np.empty(num_cables)
    for k in range(num_hinges):
        for i in range(k + 1):
            whole[k, i] = mass[first + k, first + i]
        whole[k, k] += step * rig.damping[num_cables + k]
        whole[size, k] = load[first + k]
    for r in range(6):
        for k in range(num_hinges):
            whole[num_hinges + r, k] = mass[r, first + k]
        for i in range(r + 1):
            whole[num_hinges + r, num_hinges + i] = mass[r, i]
        whole[size, num_hinges + r] = load[r]
    for c in range(num_cables):
        heft[c] = mass[6 + c, 6 + c] + step * rig.damping[c]
        for r in range(6):
            share = mass[r, 6 + c] / heft[c]
            for i in range(r + 1):
                whole[num_hinges + r, num_hinges + i] -= share * mass[i, 6 + c]
            whole[size, num_hinges + r] -= share * load[6 + c]
    by_slider = np.empty(num_cables)
    by_hinge = np.zeros((num_cables, num_hinges))
    gap = cable_rows(rig, travel, frames.sine, frames.cosine, by_slider, by_hinge)
    for c in range(num_cables):
        whole[size + 1 + c, :num_hinges] = by_hinge[c]
        for r in range(6):
            whole[size + 1 + c, num_hinges + r] = -mass[r, 6 + c] / heft[c] * by_slider[c]
    inverse = factor(whole, size)
    for row in range(size, size + 1 + num_cables):
        append_row(whole, row, size, inverse)

    # (1) the problem of the cables; (2) as long as the step would carry hinges past their limits,
    # theirs too.
    count = num_cables
    most = num_cables + num_hinges
    matrix, slack = np.empty((most, most)), np.empty(most)
    pull = np.zeros(most)
    pull[:num_cables] = tension
    limited, side = np.empty(num_hinges, np.int64), np.zeros(num_hinges)
    acceleration, rest = np.empty(num_cables + num_hinges), np.empty(size)
    done = 0
    while True:
        for i in range(done, count):
            row = whole[size + 1 + i]
            for j in range(i + 1):
                value = 0.0
                for k in range(size):
                    value += row[k] * whole[size + 1 + j, k]
                matrix[i, j] = matrix[j, i] = value
            drive = 0.0
            for k in range(size):
                drive += row[k] * whole[size, k]
            if i < num_cables:
                matrix[i, i] += by_slider[i] ** 2 / heft[i]
                drive += by_slider[i] * load[6 + i] / heft[i]
                rate = by_slider[i] * velocity[6 + i]
                for k in range(num_hinges):
                    rate += by_hinge[i, k] * velocity[first + k]
                slack[i] = (_slack_rate(float(gap[i]), rig) - rate) / step - drive
            else:
                k = limited[i - num_cables]
                room = rig.limit[k] - side[k] * hinges[k]
                slack[i] = (
                    _slack_rate(float(room), rig) - side[k] * velocity[first + k]
                ) / step - drive
        done = count
        solve_complementarity(matrix, slack, count, pull)

        rest[:] = whole[size]
        for i in range(count):
            if pull[i] > 0:
                for k in range(size):
                    rest[k] -= pull[i] * whole[size + 1 + i, k]
        solve_transposed(whole, size, inverse, rest)
        acceleration[num_cables:] = rest[:num_hinges]
        for k in range(num_hinges):
            rate = velocity[first + k] + step * rest[k]
            if side[k] == 0.0 and abs(hinges[k] + step * rate) > rig.limit[k]:
                toward = 1.0 if hinges[k] + step * rate > 0 else -1.0
                if toward * rate > _slack_rate(rig.limit[k] - toward * hinges[k], rig):
                    side[k] = toward
                    limited[count - num_cables] = k
                    whole[size + 1 + count, k] = toward
                    append_row(whole, size + 1 + count, size, inverse)
                    count += 1
        if count == done:
            break

    for c in range(num_cables):
        tension[c] = pull[c]
        push = load[6 + c] - by_slider[c] * pull[c]
        for r in range(6):
            push -= mass[r, 6 + c] * rest[num_hinges + r]
        acceleration[c] = push / heft[c]
        force[c] -= by_slider[c] * pull[c]
        for k in range(num_hinges):
            force[num_cables + k] -= by_hinge[c, k] * pull[c]
    for i in range(num_cables, count):
        k = limited[i - num_cables]
        force[num_cables + k] -= side[k] * pull[i]
    return force - step * rig.damping * acceleration


@numba.njit(cache=True)
def joint_forces(
    chain: Chain,
    rig: Rig,
    plant: Plant,
    position: Array,
    velocity: Array,
    command: Array,
    tension: Array,
    force: Array,
) -> None:
    """Joint forces of the coming step of many copies.

    Args:
        chain, rig: the robot's numbers.
        plant: the copies' own, which replace them.
        position: as in a Snapshot, shape (num, 7 + C + 2 J).
        velocity: shape (num, nv).
        command: servo set-points, shape (num, C), in [m].
        tension: shape (num, C), in [N]; updated. The old tensions are only the first guess of which
            cables pull.
        force: filled, shape (num, C + 2 J), in [N] and [N m].
    """
    for n in range(position.shape[0]):
        own = own_chain(chain, plant, n), own_rig(rig, plant, n)
        force[n] = _joint_forces(own[0], own[1], position[n], velocity[n], command[n], tension[n])
