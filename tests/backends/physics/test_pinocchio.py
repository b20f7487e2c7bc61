"""Both engines' equation of motion, compared with Pinocchio's, which reads the exported URDF."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backends.export.model_files import write_model
from backends.parity.one_state import compare, random_states
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, Dynamics, Snapshot
from cdcsr.simulation.engines import load_backend
from cdcsr.simulation.rotations import rotation_matrix
from tests.support.random_robots import KINDS

pinocchio: Any = pytest.importorskip(
    "pinocchio", reason="Pinocchio has no package for this platform"
)


def load(robot: Robot, folder: Path) -> Any:
    """Return Pinocchio's model of the URDF that `cdcsr build-model` writes, on a free base, with a
    frame at the tip."""
    write_model(robot, folder, ["pybullet"])
    model = pinocchio.buildModelFromUrdf(
        str(folder / f"{robot.name}.urdf"), pinocchio.JointModelFreeFlyer()
    )
    model.gravity = pinocchio.Motion.Zero()
    last = robot.num_links - 1
    place = pinocchio.SE3(np.eye(3), np.array([0, 0, robot.links[-1][0].length]))
    joint = model.getJointId(f"hinge_{last}_y")
    model.addFrame(pinocchio.Frame("tip", joint, place, pinocchio.FrameType.OP_FRAME))
    return model


def equation(
    robot: Robot, model: Any, position: Array, velocity: Array
) -> tuple[Array, Array, Array]:
    """Return mass matrix, bias force and tip Jacobian at one state, in the contract's
    coordinates."""
    names = [f"slide_{c}" for c in range(robot.num_cables)]
    names += [f"hinge_{j}_{axis}" for j in range(robot.num_links) for axis in "xy"]
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    turn = rotation_matrix(position[3:7])
    # Pinocchio's velocity is [linear, angular] in the base's frame, then its own order of joints.
    to_theirs = np.zeros((model.nv, model.nv))
    to_theirs[:3, :3] = to_theirs[3:6, 3:6] = turn.T
    to_theirs[order, 6 + np.arange(len(order))] = 1
    q, v = np.zeros(model.nq), to_theirs @ velocity
    q[:3], q[3:7] = position[:3], position[[4, 5, 6, 3]]
    q[1 + np.array(order)] = position[7:]
    data = model.createData()
    mass = pinocchio.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    # The base's frame turns: d(R^T v)/dt is R^T dv/dt - omega x v, with omega and v in that frame.
    turning = np.zeros(model.nv)
    turning[:3] = -np.cross(v[3:6], v[:3])
    bias = pinocchio.nonLinearEffects(model, data, q, v) + mass @ turning
    jacobian = pinocchio.computeFrameJacobian(
        model, data, q, model.getFrameId("tip"), pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )[:3]
    return to_theirs.T @ mass @ to_theirs, to_theirs.T @ bias, jacobian @ to_theirs


def evaluation(robot: Robot, backend: str, states: Snapshot) -> Dynamics:
    simulation = load_backend(backend)(robot, len(states.time))
    simulation.set_snapshot(states)
    found = simulation.dynamics()
    simulation.close()
    return found


@pytest.mark.parametrize("name", KINDS)
def test_both_engines_have_pinocchios_equation_of_motion(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    states = random_states(robot, 6, seed=3)
    model = load(robot, tmp_path)
    assert model.nv == robot.num_coordinates
    rows = [
        equation(robot, model, p, v) for p, v in zip(states.position, states.velocity, strict=True)
    ]
    mass, bias, tip = (np.stack(part) for part in zip(*rows, strict=True))
    found = {name: evaluation(robot, name, states) for name in ("mujoco", "pybullet")}
    for source, dynamics in found.items():
        theirs = dataclasses.replace(dynamics, mass_matrix=mass, bias_force=bias, tip_jacobian=tip)
        failed = [
            str(c)
            for c in compare(robot, dynamics, theirs, f"{source} - pinocchio")
            if not c.passed
        ]
        assert failed == []
