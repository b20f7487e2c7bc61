"""Copies with parameters of their own in a batch that shares one model."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]


def write_plant(many: batch.Batch, ids: NDArray[np.int64], plant: Plant) -> None:
    """Give copies `ids` the parameters in the rows of `plant`, but for the rest lengths of cables.

    The model has the order of the description: the base's body is the first and the links' bodies
    are the last, root to tip; sliders precede hinges, and both follow the base. The caller must
    call `forward` afterwards, so that what the batch has computed from the state is up to date.
    """
    model = many.model
    base, first_link = model.body("base").id, model.body("link_0").id
    joints = slice(model.nv - plant.damping.shape[1], None)
    mass, inertia = many.expand("body_mass"), many.expand("body_inertia")
    armature = many.expand("dof_armature")
    before = mass[ids], inertia[ids], armature[ids]
    mass[ids, base], inertia[ids, base] = plant.base_mass, plant.base_inertia
    mass[ids, first_link:], inertia[ids, first_link:] = plant.link_mass, plant.link_inertia
    many.expand("jnt_stiffness")[ids, -plant.stiffness.shape[1] :] = plant.stiffness
    many.expand("dof_damping")[ids, joints] = plant.damping
    if model.dof_armature.any():  # see stepping_spec
        armature[ids, joints] = model.opt.timestep * plant.damping
    sign = np.sign(model.actuator_gainprm[:, 0])
    many.expand("actuator_gainprm")[ids, :, 0] = plant.servo_gain * sign
    returns = model.actuator_biasprm[:, 1] != 0
    many.expand("actuator_biasprm")[ids, :, 1] = -plant.servo_gain * returns
    # The softness of constraints depends on the masses; no other parameter here changes it.
    moved = (mass[ids] != before[0]).any(axis=1) | (inertia[ids] != before[1]).any(axis=(1, 2))
    moved |= (armature[ids] != before[2]).any(axis=1)
    many.set_const(ids[moved])


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
