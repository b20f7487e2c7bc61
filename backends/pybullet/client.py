"""Load a robot into PyBullet, without the damping, motors and limits that PyBullet adds."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pybullet

from backends.pybullet.urdf import joint_names, urdf
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Plant

MAX_JOINT_SPEED = 1e9
"""The clamp on joint speeds, in [m/s] or [rad/s]. PyBullet's own is 100; no speed that is not a
failure comes near this one."""


def connect(robot: Robot) -> int:
    """Open a physics client without gravity at the robot's time step; the caller disconnects it.

    Raises:
        CdcsrError: PyBullet has no free client left.
    """
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise CdcsrError(
            "PyBullet has no free physics client left; close() simulations that are not needed."
        )
    pybullet.setTimeStep(robot.time_step, physicsClientId=client)
    pybullet.setGravity(0, 0, 0, physicsClientId=client)
    return client


def load_robot_body(robot: Robot, client: int) -> int:
    """Load one copy, straight and at rest at the origin, with no damping, motors, limits or
    contacts.

    Args:
        robot: the description.
        client: the physics client.

    Returns:
        The body's id.

    Raises:
        CdcsrError: PyBullet read the joints in another order.
    """
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    flags |= pybullet.URDF_IGNORE_COLLISION_SHAPES | pybullet.URDF_IGNORE_VISUAL_SHAPES
    # The name is new each time: PyBullet caches files by their path, and other processes load too.
    handle, name = tempfile.mkstemp(prefix=f"{robot.fingerprint}_", suffix=".urdf")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(urdf(robot))
        body = pybullet.loadURDF(name, flags=flags, physicsClientId=client)
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
    # These three belong to the whole body. PyBullet redirects any call that sets the speed limit to
    # the base, so a joint's damping must not be set in the same call.
    pybullet.changeDynamics(
        body,
        -1,
        linearDamping=0.0,
        angularDamping=0.0,
        maxJointVelocity=MAX_JOINT_SPEED,
        physicsClientId=client,
    )
    for joint in range(count):  # an inverted range removes PyBullet's own limit
        pybullet.changeDynamics(
            body,
            joint,
            jointDamping=0.0,
            jointLowerLimit=1.0,
            jointUpperLimit=-1.0,
            physicsClientId=client,
        )
    pybullet.setJointMotorControlArray(
        body, range(count), pybullet.VELOCITY_CONTROL, forces=[0.0] * count, physicsClientId=client
    )
    return body


def set_masses(client: int, body: int, plant: Plant, row: int) -> None:
    """Set the masses and inertias of a body to those in one row of `plant`.

    calculateMassMatrix, calculateInverseDynamics and calculateJacobian go on with the masses that
    the body had when one of them was first called, even if that body was removed and another one
    has taken its place in memory.
    """
    num_links = plant.link_mass.shape[1]
    first = pybullet.getNumJoints(body, physicsClientId=client) - 2 * num_links
    bodies = [(-1, plant.base_mass[row], plant.base_inertia[row])]
    # A link's own body is at the second of its two hinges.
    bodies += [
        (first + 2 * j + 1, plant.link_mass[row, j], plant.link_inertia[row, j])
        for j in range(num_links)
    ]
    for index, mass, inertia in bodies:  # with a mass alone PyBullet would compute an inertia
        moments = inertia.tolist()
        # The largest moment of a flat body is the sum of the other two. If rounding put it above,
        # PyBullet's functions would fail.
        largest = moments.index(max(moments))
        moments[largest] = min(moments[largest], sum(moments[:largest] + moments[largest + 1 :]))
        pybullet.changeDynamics(
            body, index, mass=float(mass), localInertiaDiagonal=moments, physicsClientId=client
        )
