"""Copies with parameters of their own in a batch that shares one model."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Plant
from cdcsr.simulation.rotations import rotation_matrix
from cdcsr.simulation.state import Dynamics

Array = NDArray[np.float64]

MASSES = ("body_mass", "body_inertia", "dof_armature")
"""The arrays of a model that tell masses."""
_CHANGED = (
    *MASSES,
    *("jnt_stiffness", "dof_damping", "actuator_gainprm", "actuator_biasprm"),
)


def write_plant(many: batch.Batch, ids: NDArray[np.int64], plant: Plant) -> None:
    """Give copies `ids` the parameters in the rows of `plant`, but for the rest lengths of cables.

    The caller must call `forward` afterwards, so that what the batch has computed from the state is
    up to date.
    """
    moved = np.zeros(len(ids), dtype=bool)
    for name, rows in plant_fields(many.model, plant).items():
        array = many.expand(name)
        # The softness of constraints depends on these; no other parameter here changes it.
        if name in MASSES:
            moved |= (array[ids] != rows).any(axis=tuple(range(1, rows.ndim)))
        array[ids] = rows
    many.set_const(ids[moved])


def plant_fields(model: mujoco.MjModel, plant: Plant) -> dict[str, Array]:
    """Return the arrays of a model that parameters change, by name, with a row for each row of
    `plant`; of cables only what their servos are.

    The model has the order of the description: the base's body is the first and the links' bodies
    are the last, root to tip; sliders precede hinges, and both follow the base.
    """
    num, base, first_link = len(plant.base_mass), model.body("base").id, model.body("link_0").id
    joints = slice(model.nv - plant.damping.shape[1], None)
    rows = {name: np.repeat(getattr(model, name)[None], num, axis=0) for name in _CHANGED}
    rows["body_mass"][:, base], rows["body_inertia"][:, base] = plant.base_mass, plant.base_inertia
    rows["body_mass"][:, first_link:] = plant.link_mass
    rows["body_inertia"][:, first_link:] = plant.link_inertia
    rows["jnt_stiffness"][:, -plant.stiffness.shape[1] :] = plant.stiffness
    rows["dof_damping"][:, joints] = plant.damping
    if model.dof_armature.any():  # see stepping_spec
        rows["dof_armature"][:, joints] = model.opt.timestep * plant.damping
    sign = np.sign(model.actuator_gainprm[:, 0])
    rows["actuator_gainprm"][..., 0] = plant.servo_gain * sign
    returns = model.actuator_biasprm[:, 1] != 0
    rows["actuator_biasprm"][..., 1] = -plant.servo_gain * returns
    return rows


def turn_base(found: Dynamics, quaternion: Array) -> Dynamics:
    """Turn the part of a free base's rotation in an equation of motion into the world frame.

    MuJoCo's base angular velocity is in the base frame: v_body = R^T v_world. The rate of R^T has
    no part in the bias, because the rotation of a body leaves its angular velocity unchanged.

    Args:
        found: its arrays are changed.
        quaternion: how the bases are turned, shape (n, 4).
    """
    turn, part = rotation_matrix(quaternion), slice(3, 6)
    for vector in (found.velocity, found.bias_force, found.passive_force):
        vector[:, part] = np.einsum("nij,nj->ni", turn, vector[:, part])
    mass, tip = found.mass_matrix, found.tip_jacobian
    mass[:, part, :] = turn @ mass[:, part, :]
    mass[:, :, part] = mass[:, :, part] @ turn.swapaxes(1, 2)
    tip[:, :, part] = tip[:, :, part] @ turn.swapaxes(1, 2)
    return found


def dense_tendon_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the derivatives of all tendons' lengths, shape (ntendon, nv)."""
    dense = np.zeros((model.ntendon, model.nv))
    columns = model.ten_J_colind.ravel()
    mujoco.mju_sparse2dense(
        dense, data.ten_J.ravel(), model.ten_J_rownnz, model.ten_J_rowadr, columns
    )
    return dense


def load_force(model: mujoco.MjModel, data: mujoco.MjData, loads: Loads, copy: int) -> Array:
    """Return the generalized force of the loads on one copy, shape (model.nv,)."""
    total = np.zeros(model.nv)
    first_link = model.body("link_0").id
    force, torque, point = loads.force[copy], loads.torque[copy], loads.point[copy]
    for link, slot in np.argwhere(force.any(axis=-1) | torque.any(axis=-1)):
        body, one = first_link + int(link), (link, slot)
        place = data.xipos[body] + data.xmat[body].reshape(3, 3) @ point[one]
        mujoco.mj_applyFT(model, data, force[one], torque[one], place, body, total)
    return total
