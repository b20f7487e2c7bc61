"""The equation of motion from the arrays of MuJoCo Warp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from backends.mujoco.copies import turn_base
from backends.warp.device import Copies
from cdcsr.robot.description import Robot
from cdcsr.simulation.state import Array, Dynamics


def equation_of_motion(
    copies: Copies, robot: Robot, ids: NDArray[np.int64], quaternion: Array
) -> Dynamics:
    """Return the equation of motion of copies `ids`, without loads.

    Args:
        copies: all of them; what follows from their state is up to date.
        robot: their description.
        ids: n of them.
        quaternion: how their bases are turned, shape (n, 4).
    """
    host, data, nv = copies.host, copies.data, robot.num_coordinates
    first = nv - host.nv  # a fixed base has no coordinates there

    def rows(array: Any) -> Array:  # Warp has no types
        return np.array(array.numpy()[ids], dtype=np.float64)

    def whole(array: Any) -> Array:
        return np.pad(rows(array), [(0, 0), (first, 0)])

    mass = np.tile(np.eye(nv), (len(ids), 1, 1))
    row, column = first + np.repeat(np.arange(host.nv), host.M_rownnz), first + host.M_colind
    mass[:, row, column] = mass[:, column, row] = rows(data.M)
    own = np.broadcast_to(copies.model.dof_armature.numpy(), (copies.num, host.nv))[ids]
    diagonal = np.arange(first, nv)
    mass[:, diagonal, diagonal] -= own  # no mass: see stepping_spec
    cables = np.zeros((len(ids), robot.num_cables, nv))
    row = np.repeat(np.arange(host.ntendon), host.ten_J_rownnz)
    cables[:, row, first + host.ten_J_colind.ravel()] = rows(data.ten_J)
    # How a coordinate moves the tip's body, angular then linear, about the robot's centre of mass.
    site = host.site("tip").id
    center = rows(data.subtree_com)[:, host.body_rootid[host.site_bodyid[site]]]
    motion, arm = rows(data.cdof), rows(data.site_xpos)[:, site] - center
    tip = np.zeros((len(ids), 3, nv))
    tip[..., first:] = (motion[..., 3:] + np.cross(motion[..., :3], arm[:, None])).swapaxes(1, 2)
    tip[..., 6 : 6 + robot.num_cables] = 0.0  # sliders do not carry it
    bias, passive = whole(data.qfrc_bias), whole(data.qfrc_passive)
    velocity, length = whole(data.qvel), rows(data.ten_length)
    found = Dynamics(mass, bias, passive, tip, cables, velocity, length)
    return found if first else turn_base(found, quaternion)
