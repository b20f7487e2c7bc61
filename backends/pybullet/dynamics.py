"""Rigid-body dynamics of the robot, compiled: what the cables' complementarity problem needs at
every step.

PyBullet's own mass matrix takes longer than its whole step, so the kernel has its own. Everything
is in the world frame with the base's centre as the point of reference, and without gravity.
Coordinates are in the declared order: base linear, base angular, sliders, hinges root to tip (x
before y). With

    motion of hinge k   (p_k x a_k, a_k)   its unit velocity at the base's centre, and its axis
    motion of slider c  (e_z, 0)

the mass matrix is Featherstone's composite-rigid-body algorithm, and the bias force Newton-Euler
with zero accelerations. Compiled code is cached by the file that defines it: when a function that
others inline has changed, their caches must be removed too (``__pycache__/*.nb?``).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from backends.pybullet.urdf import slider_places
from backends.pybullet.vectors import Vec, add, blend, cross, dot, vec
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """Masses and lengths as plain arrays (C sliders, J links)."""

    base_mass: float
    base_inertia: Array
    """(3,) [kg m^2]."""
    top: float
    """Height of the first joint above the base's centre in [m]."""
    slider_place: Array
    """(C, 3) at rest, in the base's frame, in [m]."""
    slider_mass: Array
    """(C,) [kg]."""
    slider_moment: Array
    """(C,) the same about every axis, in [kg m^2]."""
    link_mass: Array
    """(J,) [kg]."""
    link_inertia: Array
    """(J, 3) principal moments about the link's centre in [kg m^2]."""
    link_length: Array
    """(J,) [m]."""


class Frames(NamedTuple):
    """Where everything is, relative to the base's centre, world axes."""

    axes: Array
    """(J + 1, 3, 3): rows are the x, y, z axes of the base and of each link."""
    motion: Array
    """(2 J, 6): velocity at the base's centre and axis, for a unit rate of each hinge."""
    joint: Array
    """(J + 1, 3): place of each joint, and of the tip."""
    center: Array
    """(J, 3): centre of mass of each link."""
    slider: Array
    """(C, 3)."""
    sine: Array
    """(2 J,) of the hinge angles."""
    cosine: Array
    """(2 J,) of the hinge angles."""


def chain(robot: Robot) -> Chain:
    """The numbers of a robot that its dynamics needs."""
    links = [link for link, _ in robot.links]
    mass = np.array([servo.mass for servo in robot.servos])
    radius = np.array([servo.radius for servo in robot.servos])
    return Chain(
        base_mass=robot.base.mass,
        base_inertia=np.array(robot.base.inertia),
        top=robot.top,
        slider_place=slider_places(robot),
        slider_mass=mass,
        slider_moment=0.4 * mass * radius**2,
        link_mass=np.array([link.mass for link in links]),
        link_inertia=np.array([link.inertia for link in links]),
        link_length=np.array([link.length for link in links]),
    )


@numba.njit(cache=True)
def own_chain(chain: Chain, plant: Plant, row: int) -> Chain:
    """The numbers of one copy: masses and inertias from a row of `plant`, all else from the
    description."""
    return Chain(
        plant.base_mass[row],
        plant.base_inertia[row],
        chain.top,
        chain.slider_place,
        chain.slider_mass,
        chain.slider_moment,
        plant.link_mass[row],
        plant.link_inertia[row],
        chain.link_length,
    )


@numba.njit(cache=True)
def _turned(moments: Array, axes: Array, a: Vec) -> Vec:
    """A body's inertia, given by moments and axes, times a vector."""
    x, y, z = vec(axes[0]), vec(axes[1]), vec(axes[2])
    in_plane = blend(moments[0] * dot(x, a), x, moments[1] * dot(y, a), y)
    return blend(1.0, in_plane, moments[2] * dot(z, a), z)


@numba.njit(cache=True)
def forward_kinematics(chain: Chain, position: Array) -> Frames:
    """Where everything is.

    Args:
        chain: the robot's numbers.
        position: base position, base quaternion (w-x-y-z), sliders, hinges; shape (7 + C + 2 J,).
    """
    num_sliders, num_links = chain.slider_mass.size, chain.link_mass.size
    axes = np.empty((num_links + 1, 3, 3))
    motion = np.empty((2 * num_links, 6))
    joint = np.empty((num_links + 1, 3))
    center = np.empty((num_links, 3))
    slider = np.empty((num_sliders, 3))
    sine = np.sin(position[7 + num_sliders :])
    cosine = np.cos(position[7 + num_sliders :])
    w, i, j, k = position[3], position[4], position[5], position[6]
    x = (1 - 2 * (j * j + k * k), 2 * (i * j + w * k), 2 * (i * k - w * j))
    y = (2 * (i * j - w * k), 1 - 2 * (i * i + k * k), 2 * (j * k + w * i))
    z = (2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j))
    axes[0, 0], axes[0, 1], axes[0, 2] = x, y, z
    for c in range(num_sliders):
        across = blend(chain.slider_place[c, 0], x, chain.slider_place[c, 1], y)
        slider[c] = blend(1.0, across, chain.slider_place[c, 2] + position[7 + c], z)
    place = blend(chain.top, z, 0.0, z)
    for n in range(num_links):
        joint[n] = place
        s, c = sine[2 * n], cosine[2 * n]
        motion[2 * n, :3], motion[2 * n, 3:] = cross(place, x), x
        y, z = blend(c, y, s, z), blend(c, z, -s, y)
        s, c = sine[2 * n + 1], cosine[2 * n + 1]
        motion[2 * n + 1, :3], motion[2 * n + 1, 3:] = cross(place, y), y
        z, x = blend(c, z, s, x), blend(c, x, -s, z)
        axes[n + 1, 0], axes[n + 1, 1], axes[n + 1, 2] = x, y, z
        center[n] = blend(1.0, place, 0.5 * chain.link_length[n], z)
        place = blend(1.0, place, chain.link_length[n], z)
    joint[num_links] = place
    return Frames(axes, motion, joint, center, slider, sine, cosine)


@numba.njit(cache=True)
def _add_body(composite: Array, mass: float, moments: Array, axes: Array, at: Vec) -> None:
    """Add a body to a composite: mass, first moment (3), and xx, yy, zz, xy, xz, yz of its
    inertia."""
    composite[0] += mass
    for r in range(3):
        composite[1 + r] += mass * at[r]
        composite[4 + r] += mass * (dot(at, at) - at[r] * at[r])
        for k in range(3):
            composite[4 + r] += moments[k] * axes[k, r] * axes[k, r]
    composite[7] -= mass * at[0] * at[1]
    composite[8] -= mass * at[0] * at[2]
    composite[9] -= mass * at[1] * at[2]
    for k in range(3):
        composite[7] += moments[k] * axes[k, 0] * axes[k, 1]
        composite[8] += moments[k] * axes[k, 0] * axes[k, 2]
        composite[9] += moments[k] * axes[k, 1] * axes[k, 2]


@numba.njit(cache=True)
def mass_matrix(chain: Chain, frames: Frames) -> Array:
    """The mass matrix, shape (nv, nv) with nv = 6 + C + 2 J."""
    num_sliders, num_links = chain.slider_mass.size, chain.link_mass.size
    first = 6 + num_sliders
    size = first + 2 * num_links
    matrix = np.zeros((size, size))
    composite, momentum = np.zeros(10), np.empty(6)
    for n in range(num_links - 1, -1, -1):
        _add_body(
            composite,
            chain.link_mass[n],
            chain.link_inertia[n],
            frames.axes[n + 1],
            vec(frames.center[n]),
        )
        b = composite
        moment = (b[1], b[2], b[3])
        for hinge in (2 * n + 1, 2 * n):
            v, a = vec(frames.motion[hinge]), vec(frames.motion[hinge, 3:])
            spin = (
                b[4] * a[0] + b[7] * a[1] + b[8] * a[2],
                b[7] * a[0] + b[5] * a[1] + b[9] * a[2],
                b[8] * a[0] + b[9] * a[1] + b[6] * a[2],
            )
            momentum[:3] = blend(b[0], v, 1.0, cross(a, moment))
            momentum[3:] = add(spin, cross(moment, v))
            row = first + hinge
            for r in range(6):
                matrix[row, r] = matrix[r, row] = momentum[r]
            for other in range(hinge + 1):
                value = 0.0
                for r in range(6):
                    value += frames.motion[other, r] * momentum[r]
                matrix[row, first + other] = matrix[first + other, row] = value
    upright = np.eye(3)
    z = vec(frames.axes[0, 2])
    for c in range(num_sliders):
        mass, at = chain.slider_mass[c], vec(frames.slider[c])
        _add_body(composite, mass, np.full(3, chain.slider_moment[c]), upright, at)
        momentum[:3] = blend(mass, z, 0.0, z)
        momentum[3:] = cross(at, vec(momentum))
        for r in range(6):
            matrix[6 + c, r] = matrix[r, 6 + c] = momentum[r]
        matrix[6 + c, 6 + c] = mass
    _add_body(composite, chain.base_mass, chain.base_inertia, frames.axes[0], (0.0, 0.0, 0.0))
    b = composite
    for r in range(3):
        matrix[r, r] = b[0]
        matrix[3 + r, 3 + r] = b[4 + r]
        for k in range(3):
            if r != k:
                matrix[3 + r, 3 + k] = b[6 + r + k]
    # Angular momentum of a unit translation: first moment x direction.
    matrix[0, 4] = matrix[4, 0] = b[3]
    matrix[1, 3] = matrix[3, 1] = -b[3]
    matrix[1, 5] = matrix[5, 1] = b[1]
    matrix[2, 4] = matrix[4, 2] = -b[1]
    matrix[2, 3] = matrix[3, 2] = b[2]
    matrix[0, 5] = matrix[5, 0] = -b[2]
    return matrix


@numba.njit(cache=True)
def bias_force(chain: Chain, frames: Frames, velocity: Array) -> Array:
    """Coriolis, centrifugal and gyroscopic forces, shape (nv,).

    Args:
        chain, frames: the robot's numbers and where everything is.
        velocity: shape (nv,); the base's linear part has no effect.
    """
    num_sliders, num_links = chain.slider_mass.size, chain.link_mass.size
    first = 6 + num_sliders
    bias = np.empty(first + 2 * num_links)
    forces = np.empty((num_links, 6))
    base_rate = vec(velocity[3:6])

    rate, speeding = base_rate, (0.0, 0.0, 0.0)
    start = vec(frames.joint[0])
    acceleration = cross(rate, cross(rate, start))
    for n in range(num_links):
        for hinge in (2 * n, 2 * n + 1):
            turn = velocity[first + hinge]
            axis = vec(frames.motion[hinge, 3:])
            speeding = blend(1.0, speeding, turn, cross(rate, axis))
            rate = blend(1.0, rate, turn, axis)
        half = blend(0.5 * chain.link_length[n], vec(frames.axes[n + 1, 2]), 0.0, rate)
        gain = add(cross(speeding, half), cross(rate, cross(rate, half)))
        force = blend(chain.link_mass[n], add(acceleration, gain), 0.0, rate)
        moments, axes = chain.link_inertia[n], frames.axes[n + 1]
        torque = add(_turned(moments, axes, speeding), cross(rate, _turned(moments, axes, rate)))
        forces[n, :3] = force
        forces[n, 3:] = add(torque, cross(vec(frames.center[n]), force))
        acceleration = blend(1.0, acceleration, 2.0, gain)

    total, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for n in range(num_links - 1, -1, -1):
        total = add(total, vec(forces[n]))
        moment = add(moment, vec(forces[n, 3:]))
        for hinge in (2 * n + 1, 2 * n):
            motion = frames.motion[hinge]
            bias[first + hinge] = dot(vec(motion), total) + dot(vec(motion[3:]), moment)
    z = vec(frames.axes[0, 2])
    for c in range(num_sliders):
        at = vec(frames.slider[c])
        inward = cross(base_rate, cross(base_rate, at))
        aside = cross(base_rate, z)
        mass = chain.slider_mass[c]
        force = blend(mass, inward, 2.0 * mass * velocity[6 + c], aside)
        bias[6 + c] = dot(z, force)
        total, moment = add(total, force), add(moment, cross(at, force))
    gyroscopic = cross(base_rate, _turned(chain.base_inertia, frames.axes[0], base_rate))
    bias[:3] = total
    bias[3:6] = add(moment, gyroscopic)
    return bias


@numba.njit(cache=True)
def tip_states(chain: Chain, positions: Array, velocities: Array) -> tuple[Array, Array]:
    """Position and velocity of the tips of many copies.

    Args:
        chain: the robot's numbers.
        positions: shape (num, 7 + C + 2 J).
        velocities: shape (num, nv).

    Returns:
        Two arrays of shape (num, 3), in [m] and [m/s].
    """
    num, first = positions.shape[0], 6 + chain.slider_mass.size
    place, speed = np.empty((num, 3)), np.empty((num, 3))
    for n in range(num):
        frames = forward_kinematics(chain, positions[n])
        at = vec(frames.joint[-1])
        moving, rate = vec(velocities[n]), vec(velocities[n, 3:6])
        for hinge in range(frames.motion.shape[0]):
            turn = velocities[n, first + hinge]
            moving = blend(1.0, moving, turn, vec(frames.motion[hinge]))
            rate = blend(1.0, rate, turn, vec(frames.motion[hinge, 3:]))
        place[n] = add(vec(positions[n]), at)
        speed[n] = add(moving, cross(rate, at))
    return place, speed
