"""The equation of motion as the step's compiled kernel evaluates it, laid out like any engine's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.cables import Rig, cable_rows
from backends.pybullet.dynamics import Chain, bias_force, forward_kinematics, mass_matrix
from cdcsr.simulation import Dynamics

Array = NDArray[np.float64]


def kernel_dynamics(chain: Chain, rig: Rig, rest_length: Array, position: Array, velocity: Array) -> Dynamics:
    """The equation at some states, out of the functions that every step calls.

    Args:
        chain, rig: the robot's numbers.
        rest_length: of the cables, shape (C,), in [m]; the kernel itself knows only how far they are from it.
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
        frames = forward_kinematics(chain, position[i])
        mass[i], bias[i] = mass_matrix(chain, frames), bias_force(chain, frames, velocity[i])
        to_tip = frames.joint[-1]
        # The tip moves with the base's centre, and around it.
        tip[i, :, :3], tip[i, :, 3:6] = np.eye(3), np.cross(np.eye(3), to_tip).T
        tip[i, :, 6 + cables :] = (frames.motion[:, :3] + np.cross(frames.motion[:, 3:], to_tip)).T
        travel, by_hinge = position[i, 7 : 7 + cables], np.zeros((cables, size - 6 - cables))
        gap = cable_rows(rig, travel, frames.sine, frames.cosine, by_slider, by_hinge)
        length[i] = rest_length - gap
        cable[i, own, 6 + own], cable[i, :, 6 + cables :] = by_slider, by_hinge
    passive[:, 6:] = -rig.damping * velocity[:, 6:]
    passive[:, 6 + cables :] -= rig.stiffness * position[:, 7 + cables :]
    return Dynamics(mass, bias, passive, tip, cable, velocity.copy(), length)
