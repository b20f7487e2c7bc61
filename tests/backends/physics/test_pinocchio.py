"""Both engines' equation of motion, compared with Pinocchio's, which reads the exported URDF."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backends.contract_suite.states import KINDS
from backends.export.model_files import write_model
from backends.parity.one_state import compare, random_states
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, Dynamics, Snapshot
from cdcsr.simulation.engines import load_backend
from cdcsr.simulation.rotations import rotation_matrix
from tests.support.physics import changed

pinocchio: Any = pytest.importorskip(
    "pinocchio", reason="Pinocchio has no package for this platform"
)


def load(robot: Robot, folder: Path) -> Any:
    """Return Pinocchio's model of the URDF that `cdcsr build-model` writes, with a frame at the
    tip; a free base is a joint of its own."""
    write_model(robot, folder, ["pybullet"])
    root = [pinocchio.JointModelFreeFlyer()] if robot.base.mount == "free" else []
    model = pinocchio.buildModelFromUrdf(str(folder / f"{robot.name}.urdf"), *root)
    model.gravity = pinocchio.Motion(np.array(robot.gravity), np.zeros(3))
    last = robot.num_links - 1
    place = pinocchio.SE3(np.eye(3), np.array([0, 0, robot.links[-1][0].length]))
    joint = model.getJointId(f"hinge_{last}_{robot.hinges[-1].axis}")
    model.addFrame(pinocchio.Frame("tip", joint, place, pinocchio.FrameType.OP_FRAME))
    return model


def equation(
    robot: Robot, model: Any, position: Array, velocity: Array
) -> tuple[Array, Array, Array]:
    """Return mass matrix, bias force and tip Jacobian at one state, in the contract's coordinates;
    those of the joints alone if the base is fixed."""
    names = [f"slide_{c}" for c in range(robot.num_cables)]
    hinges = zip(robot.link_of_hinge, robot.hinges, strict=True)
    names += [f"hinge_{j}_{hinge.axis}" for j, hinge in hinges]
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    free = robot.base.mount == "free"
    turn = rotation_matrix(position[3:7])
    # Pinocchio's velocity is [linear, angular] in the base's frame, then its own order of joints.
    to_theirs = np.zeros((model.nv, model.nv))
    to_theirs[order, 6 * free + np.arange(len(order))] = 1
    if free:
        to_theirs[:3, :3] = to_theirs[3:6, 3:6] = turn.T
    q, v = np.zeros(model.nq), to_theirs @ velocity[-model.nv :]
    q[free + np.array(order)] = position[7:]
    if free:
        q[:3], q[3:7] = position[:3], position[[4, 5, 6, 3]]
    data = model.createData()
    mass = pinocchio.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    turning = np.zeros(model.nv)
    if free:
        # Its frame turns: d(R^T v)/dt is R^T dv/dt - omega x v, with omega and v in that frame.
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


ROD = {
    **{"length": 0.8, "youngs_modulus": 1e7, "poissons_ratio": 0.3, "density": 3000.0},
    **{"radius": 0.08, "inner_radius": 0.06, "damping_time": 0.1},
}
LINK = {"length": 0.2, "radius": 0.02, "mass": 1.0, "inertia": (0.004, 0.004, 0.0005)}
JOINT = {"stiffness": 2.0, "damping": 1.0, "limit": 1.5}
TWISTED = {"stiffness": 1.0, "damping": 0.5, "limit": 0.7, "lower": -0.2}
BENT_TIP = {"mass": 0.7, "inertia": (1e-3, 2e-3, 2e-3), "offset": 0.05}
PAPER = load_robot("paper")
CABLES = {key: PAPER.segments[0].model_dump()[key] for key in ("cables", "servo")}
TURNED = {"mount": "fixed", "position": (1.0, 2.0, 3.0), "quaternion": (0.5, -0.5, 0.1, 0.7)}


def described(name: str, *segments: dict[str, Any], **keys: object) -> Robot:
    """Return a robot on the base of the paper's, under a gravity that is not along an axis."""
    return changed(PAPER, name=name, gravity=(1.0, 3.0, -9.0), segments=segments, **keys)


ROBOTS = [
    *(load_robot(name) for name in KINDS),
    described("any-arm", *PAPER.model_dump()["segments"], {"links": 4, "backbone": ROD}),
    described(
        "finger",
        {
            "links": 3,
            "link": LINK,
            "joint": JOINT | {"order": "y", "lower": -0.1, "rest": (0.3,)},
            "taper": {"radius": 0.5, "mass": 0.3},
            **CABLES,
        },
        {
            "chain": [
                LINK | {"joint": JOINT | {"order": "x"}},
                LINK | {"inertia": (0.004, 0.005, 0.002)},
            ]
        }
        | {"joint": JOINT | {"order": "yx", "torsion": TWISTED}},
        payload=BENT_TIP,
    ),
    described(
        "held-arm",
        {"links": 3, "link": LINK, "joint": JOINT | {"torsion": TWISTED}, **CABLES},
        {"links": 4, "backbone": ROD | {"end_radius": 0.07, "torsion": True}},
        base=PAPER.base.model_dump() | TURNED,
        payload={"mass": 2.0},
    ),
]


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_both_engines_have_pinocchios_equation_of_motion(robot: Robot, tmp_path: Path) -> None:
    states = random_states(robot, 6, seed=3)
    model = load(robot, tmp_path)
    first = 0 if robot.base.mount == "free" else 6
    assert model.nv == robot.num_coordinates - first
    rows = [
        equation(robot, model, p, v) for p, v in zip(states.position, states.velocity, strict=True)
    ]
    mass, bias, tip = (np.stack(part) for part in zip(*rows, strict=True))
    found = {name: evaluation(robot, name, states) for name in ("mujoco", "pybullet")}
    for source, dynamics in found.items():
        theirs = dataclasses.replace(
            dynamics,
            mass_matrix=dynamics.mass_matrix.copy(),
            bias_force=dynamics.bias_force.copy(),
            tip_jacobian=dynamics.tip_jacobian.copy(),
        )
        theirs.mass_matrix[:, first:, first:] = mass
        theirs.bias_force[:, first:], theirs.tip_jacobian[:, :, first:] = bias, tip
        failed = [
            str(c)
            for c in compare(robot, dynamics, theirs, f"{source} - pinocchio")
            if not c.passed
        ]
        assert failed == []


def test_a_fixed_base_hangs_where_the_description_says(tmp_path: Path) -> None:
    """Pinocchio reads no free base from the file; base and tip are where the engines have them."""
    robot = ROBOTS[-1]
    model = load(robot, tmp_path)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, pinocchio.neutral(model))
    tip = data.oMf[model.getFrameId("tip")].translation
    for engine in ("mujoco", "pybullet"):
        simulation = load_backend(engine)(robot)
        np.testing.assert_allclose(simulation.state().tip_position[0], tip, atol=1e-12)
        simulation.close()
