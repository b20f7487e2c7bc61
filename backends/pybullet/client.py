"""Getting a robot into PyBullet without what PyBullet adds of its own."""

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
"""PyBullet clamps joint speeds, by default at 100; nothing that still means anything comes near this."""
OWN_JOINT_SPEED, OWN_DAMPING = 100.0, 0.04
"""PyBullet's defaults: the clamp in [m/s] or [rad/s], and the damping of all motion, linear and angular."""


def connect(robot: Robot) -> int:
    """A new physics client without gravity at the robot's time step; the caller disconnects it."""
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise CdcsrError(
            "PyBullet has no free physics client left; close() simulations that are no longer needed."
        )
    pybullet.setTimeStep(robot.time_step, physicsClientId=client)
    pybullet.setGravity(0, 0, 0, physicsClientId=client)
    return client


def load_robot_body(robot: Robot, client: int) -> int:
    """Load one copy, straight and at rest at the origin, with no damping, motors, limits or contacts.

    Args:
        robot: the description.
        client: physics client.

    Returns:
        The body's id.
    """
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    flags |= pybullet.URDF_IGNORE_COLLISION_SHAPES | pybullet.URDF_IGNORE_VISUAL_SHAPES
    # A fresh name each time: PyBullet remembers files by their path, and another process may load at once.
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
            f"PyBullet ordered the joints of {robot.name} in another way than they were written: {found}."
        )
    # These three are of the whole body. PyBullet redirects any call that sets the speed limit to the base, so a
    # joint's damping must not be set along with it.
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


def use_own_settings(client: int, body: int) -> None:
    """Give a body back the damping and the clamp on joint speeds that :func:`load_robot_body` took away."""
    pybullet.changeDynamics(
        body,
        -1,
        linearDamping=OWN_DAMPING,
        angularDamping=OWN_DAMPING,
        maxJointVelocity=OWN_JOINT_SPEED,
        physicsClientId=client,
    )


def set_masses(client: int, body: int, plant: Plant, row: int) -> None:
    """Give a body the masses and inertias in one row of `plant`.

    PyBullet answers calculateMassMatrix, calculateInverseDynamics and calculateJacobian with the masses that a body
    had when first asked, even where that body was removed and another one has taken its place in memory.
    """
    num_links = plant.link_mass.shape[1]
    first = pybullet.getNumJoints(body, physicsClientId=client) - 2 * num_links
    bodies = [(-1, plant.base_mass[row], plant.base_inertia[row])]
    # A link's own body is at the second of its two hinges.
    bodies += [
        (first + 2 * j + 1, plant.link_mass[row, j], plant.link_inertia[row, j])
        for j in range(num_links)
    ]
    for index, mass, inertia in bodies:  # a new mass alone would bring an inertia of PyBullet's own
        moments = inertia.tolist()
        # Where the largest is the sum of the other two, as a flat body's is, rounding must not put it above: PyBullet
        # would answer no more questions.
        largest = moments.index(max(moments))
        moments[largest] = min(moments[largest], sum(moments[:largest] + moments[largest + 1 :]))
        pybullet.changeDynamics(
            body, index, mass=float(mass), localInertiaDiagonal=moments, physicsClientId=client
        )
