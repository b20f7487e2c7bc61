"""Load a robot into PyBullet, and choose which of PyBullet's defaults act on it."""

from __future__ import annotations

import os
import tempfile
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import pybullet

from backends.pybullet.urdf import joint_names, urdf
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Plant

MOST_JOINTS = 127
"""A body with more joints is loaded, but PyBullet's functions fail on it."""
MAX_JOINT_SPEED = 1e9
"""Bullet clamps joint speeds, in [m/s] and [rad/s], at 100 by default. No speed that is not a
failure comes near this one."""
_STOP_FORCE = 1e9
"""The most that a slider's stop pushes, in [N]. Bullet's default, an impulse of 100 N s in a step,
does not stop an arm that is swung against a short cable."""


def connect(robot: Robot, substeps: int = 1) -> int:
    """Open a physics client with the robot's gravity and time step; the caller disconnects it.

    Args:
        robot: the description.
        substeps: how many steps of the client make one time step.

    Raises:
        CdcsrError: PyBullet has no free client left.
    """
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise CdcsrError(
            "PyBullet has no free physics client left; close() simulations that are not needed."
        )
    pybullet.setTimeStep(robot.time_step / substeps, physicsClientId=client)
    pybullet.setGravity(*robot.gravity, physicsClientId=client)
    return client


def load_robot_body(robot: Robot, client: int, fixed: bool = False, solid: bool = False) -> int:
    """Load one copy, straight and at rest at the origin.

    It keeps Bullet's joint damping and its limits of hinges and sliders. No other damping and no
    motors act on it.

    Args:
        robot: the description.
        client: the physics client.
        fixed: whether its base never moves.
        solid: whether its base and links touch each other; neighbours never do.

    Returns:
        The body's id.

    Raises:
        CdcsrError: the robot has more joints than a PyBullet body, or PyBullet read them in
            another order.
    """
    joints = robot.num_cables + robot.num_hinges
    if joints > MOST_JOINTS:
        raise CdcsrError(
            f"PyBullet moves at most {MOST_JOINTS} joints in a body; {robot.name} has {joints}, of "
            f"{robot.num_cables} cables and {robot.num_hinges} hinges of {robot.num_links} links. "
            "Describe it with fewer links, or use the engine mujoco."
        )
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_IGNORE_VISUAL_SHAPES
    flags |= pybullet.URDF_USE_SELF_COLLISION if solid else pybullet.URDF_IGNORE_COLLISION_SHAPES
    # The name is new each time: PyBullet caches files by their path, and other processes load too.
    handle, name = tempfile.mkstemp(prefix=f"{robot.fingerprint}_", suffix=".urdf")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(_text(robot, solid))
        body = pybullet.loadURDF(name, useFixedBase=fixed, flags=flags, physicsClientId=client)
    finally:
        Path(name).unlink()
    count = pybullet.getNumJoints(body, physicsClientId=client)
    found = [
        pybullet.getJointInfo(body, i, physicsClientId=client)[1].decode() for i in range(count)
    ]
    if found != joint_names(robot):
        raise CdcsrError(
            f"PyBullet read the joints of {robot.name} in another order than written: {found}."
        )
    if solid:
        for first, second in pairwise([-1, *_own_links(robot)]):
            pybullet.setCollisionFilterPair(body, body, first, second, 0, client)
    damp_and_clamp(client, body, 0.0, MAX_JOINT_SPEED)
    for slider in range(robot.num_cables):
        pybullet.changeDynamics(body, slider, jointLimitForce=_STOP_FORCE, physicsClientId=client)
    pybullet.setJointMotorControlArray(
        body, range(count), pybullet.VELOCITY_CONTROL, forces=[0.0] * count, physicsClientId=client
    )
    return body


@lru_cache(maxsize=16)
def _text(robot: Robot, solid: bool) -> str:
    """Return the URDF, which takes longer to write than to load; copies have one."""
    return urdf(robot, solid=solid)


def _own_links(robot: Robot) -> list[int]:
    """Return PyBullet's numbers of the links themselves, which are at the last of their hinges."""
    last = {j: robot.num_cables + hinge for hinge, j in enumerate(robot.link_of_hinge)}
    return [last[j] for j in range(robot.num_links)]


def damp_and_clamp(client: int, body: int, damping: float, max_joint_speed: float) -> None:
    """Set Bullet's damping of all motion of a body in [1/s], and the largest speed of its joints in
    [m/s] and [rad/s]."""
    # These belong to the whole body. PyBullet redirects any call that sets the speed limit to the
    # base, so a joint's damping must not be set in the same call.
    pybullet.changeDynamics(
        body,
        -1,
        linearDamping=damping,
        angularDamping=damping,
        maxJointVelocity=max_joint_speed,
        physicsClientId=client,
    )


def set_masses(robot: Robot, client: int, body: int, plant: Plant, row: int) -> None:
    """Set the masses and inertias of a robot's body to those in one row of `plant`.

    calculateMassMatrix, calculateInverseDynamics and calculateJacobian go on with the masses that
    the body had when one of them was first called, even if that body was removed and another one
    has taken its place in memory.
    """
    bodies = [(-1, plant.base_mass[row], plant.base_inertia[row])]
    if pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[0] == 0.0:
        bodies.clear()  # a fixed base, which a mass would set free
    bodies += zip(_own_links(robot), plant.link_mass[row], plant.link_inertia[row], strict=True)
    for index, mass, inertia in bodies:  # with a mass alone PyBullet would compute an inertia
        moments = inertia.tolist()
        # The largest moment of a flat body is the sum of the other two. If rounding put it above,
        # PyBullet's functions would fail.
        largest = moments.index(max(moments))
        moments[largest] = min(moments[largest], sum(moments[:largest] + moments[largest + 1 :]))
        pybullet.changeDynamics(
            body, index, mass=float(mass), localInertiaDiagonal=moments, physicsClientId=client
        )


def set_damping(client: int, body: int, plant: Plant, row: int) -> None:
    """Set Bullet's joint damping of a body to that in one row of `plant`."""
    for joint, damping in enumerate(plant.damping[row].tolist()):
        pybullet.changeDynamics(body, joint, jointDamping=damping, physicsClientId=client)
