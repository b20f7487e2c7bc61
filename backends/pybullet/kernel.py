"""The equation of motion as the step's compiled kernel evaluates it, laid out like any engine's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.cables import Rig, cable_rows, own_rig
from backends.pybullet.dynamics import Chain, bias_force, forward_kinematics, mass_matrix, own_chain
from cdcsr.simulation.contract import Dynamics
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]


def kernel_dynamics(
    chain: Chain, rig: Rig, plant: Plant, rest_length: Array, position: Array, velocity: Array
) -> Dynamics:
    """The equation at some states, out of the functions that every step calls.

    Args:
        chain, rig: the description's numbers.
        plant: the numbers of n copies.
        rest_length: of the cables as described, shape (C,), in [m]; the kernel itself knows only
            how far they are from their own.
        position: as in a Snapshot, shape (n, 7 + C + 2 J).
        velocity: shape (n, nv).
    """
    num, cables = len(position), rig.gain.size
    size = velocity.shape[1]
    mass, bias = np.empty((num, size, size)), np.empty((num, size))
    tip, cable = np.zeros((num, 3, size)), np.zeros((num, cables, size))
    length, passive = np.empty((num, cables)), np.zeros((num, size))
    by_slider, own = np.empty(cables), np.arange(cables)
    for i in range(num):
        own_numbers, own_cables = own_chain(chain, plant, i), own_rig(rig, plant, i)
        frames = forward_kinematics(own_numbers, position[i])
        mass[i], bias[i] = (
            mass_matrix(own_numbers, frames),
            bias_force(own_numbers, frames, velocity[i]),
        )
        to_tip = frames.joint[-1]
        # The tip moves with the base's centre, and around it.
        tip[i, :, :3], tip[i, :, 3:6] = np.eye(3), np.cross(np.eye(3), to_tip).T
        tip[i, :, 6 + cables :] = (frames.motion[:, :3] + np.cross(frames.motion[:, 3:], to_tip)).T
        travel, by_hinge = position[i, 7 : 7 + cables], np.zeros((cables, size - 6 - cables))
        gap = cable_rows(own_cables, travel, frames.sine, frames.cosine, by_slider, by_hinge)
        length[i] = rest_length + plant.rest_length_offset[i] - gap
        cable[i, own, 6 + own], cable[i, :, 6 + cables :] = by_slider, by_hinge
    passive[:, 6:] = -plant.damping * velocity[:, 6:]
    passive[:, 6 + cables :] -= plant.stiffness * position[:, 7 + cables :]
    return Dynamics(mass, bias, passive, tip, cable, velocity.copy(), length)
