"""The equation of motion out of PyBullet's own functions.

PyBullet's coordinates are [base angular, base linear, sliders, hinges], the base's in the base's
frame, and neither the base's place nor its linear velocity enters. So the bodies that are asked
stay at the origin. They never move: PyBullet keeps the masses that a body had when it was first
asked, so that a body that was given others must be loaded anew, and these are loaded for nothing
else. All float freely in a world without gravity: gravity g is an acceleration of the frame, so
that its force is M e g with the base's linear directions e; a fixed base is left out afterwards.
"""

from __future__ import annotations

import struct
import weakref
from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.client import connect, load_robot_body, set_masses
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_jacobian, cable_lengths, routing
from cdcsr.simulation.contract import Dynamics
from cdcsr.simulation.plant import Plant
from cdcsr.simulation.rotations import rotation_matrix

Array = NDArray[np.float64]

MOST_BODIES = 64
"""The largest number of bodies, each of 1 MB, beyond those in use. Before there are more, all are
loaded anew, because PyBullet remembers even bodies that were removed."""


class Equation:
    """Evaluates the equation of motion of a robot at any state, in a PyBullet client of its own."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._gravity = robot, np.array(robot.gravity)
        self._falls, self._fixed = any(robot.gravity), robot.base.mount == "fixed"
        self._client = connect(robot)
        pybullet.setGravity(0, 0, 0, physicsClientId=self._client)
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self._client)
        self._bodies: dict[bytes, int] = {}
        self._row = struct.Struct(f"{robot.num_coordinates}d").pack
        self._still = [0.0] * robot.num_coordinates
        self._route, self._rest = routing(robot), np.array(robot.start_angles)
        last_link, _ = robot.links[-1]
        self._tip_link = robot.num_cables + robot.num_hinges - 1
        # calculateJacobian takes a point in the link's own frame, not from its centre of mass.
        self._tip_place = [0.0, 0.0, last_link.length]

    def bodies(self, plant: Plant) -> list[int]:
        """Return the bodies with the masses in the rows of `plant`, for :meth:`terms`.

        Bodies that an earlier call returned may be gone after this one.
        """
        masses = (plant.base_mass, plant.base_inertia, plant.link_mass, plant.link_inertia)
        keys = [
            b"".join(part[row].tobytes() for part in masses) for row in range(len(plant.base_mass))
        ]
        if len(self._bodies.keys() | keys) > MOST_BODIES + len(keys):
            pybullet.resetSimulation(physicsClientId=self._client)
            self._bodies.clear()
        for row, key in enumerate(keys):
            if key not in self._bodies:
                self._bodies[key] = load_robot_body(self._robot, self._client)
                set_masses(self._robot, self._client, self._bodies[key], plant, row)
        return [self._bodies[key] for key in keys]

    def terms(
        self,
        body: int,
        joints: Sequence[float],
        turning: tuple[float, float, float],
        rates: Sequence[float],
        quaternion: Array,
    ) -> tuple[Array, Array]:
        """Return mass matrix and bias force, gravity included, in PyBullet's coordinates.

        Args:
            body: from :meth:`bodies`.
            joints: positions of sliders and hinges, C + H numbers, in [m] and [rad].
            turning: the base's angular velocity in the base's frame, in [rad/s].
            rates: of sliders and hinges, C + H numbers, in [m/s] and [rad/s].
            quaternion: of the base, shape (4,), w-x-y-z.

        Returns:
            The mass matrix, shape (nv, nv), and the bias force, shape (nv,). A fixed base has no
            part in either: its mass matrix is one.
        """
        rows = pybullet.calculateMassMatrix(body, joints, physicsClientId=self._client)
        force = pybullet.calculateInverseDynamics(
            body,
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *joints],
            [*turning, 0.0, 0.0, 0.0, *rates],
            self._still,
            physicsClientId=self._client,
        )
        # To pack the rows takes a third of the time that numpy.array does. An array on `bytes` is
        # read-only, which is a type of its own: compiled functions would be compiled once more.
        packed = bytearray().join([self._row(*row) for row in rows])
        # Unlike everything else in PyBullet, the force has the base's linear part first.
        bias = bytearray(self._row(*force[3:6], *force[:3], *force[6:]))
        mass, forces = np.frombuffer(packed).reshape(len(rows), -1), np.frombuffer(bias)
        if self._falls:
            forces -= mass[:, 3:6] @ (rotation_matrix(quaternion).T @ self._gravity)
        if self._fixed:
            forces[:6] = mass[:6] = mass[:, :6] = 0.0
            mass[:6, :6] = np.eye(6)
        return mass, forces

    def dynamics(
        self, position: Array, velocity: Array, plant: Plant, load: Array | None = None
    ) -> Dynamics:
        """Return the equation at n states, in the contract's coordinates.

        Args:
            position: as in a Snapshot, shape (n, 7 + C + H).
            velocity: shape (n, nv).
            plant: the numbers of n copies.
            load: the force of the loads, shape (n, nv), or None.
        """
        cables = self._robot.num_cables
        rows = map(self._one, self.bodies(plant), position, velocity)
        mass, bias, tip = (np.stack(part) for part in zip(*rows, strict=True))
        joints, rates = position[:, 7:], velocity[:, 6:]
        passive = np.zeros_like(velocity)
        passive[:, 6:] = -plant.damping * rates
        passive[:, 6 + cables :] -= plant.stiffness * (joints[:, cables:] - self._rest)
        if load is not None:
            passive += load
        cable = np.zeros((len(position), cables, velocity.shape[1]))
        travel, hinges = joints[:, :cables], joints[:, cables:]
        cable[..., 6:] = cable_jacobian(self._route, travel, hinges)
        length = cable_lengths(self._route, travel, hinges)
        return Dynamics(mass, bias, passive, tip, cable, velocity.copy(), length)

    def close(self) -> None:
        """Release the client; closing twice does nothing."""
        self._disconnect()

    def _one(self, body: int, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        """Mass matrix, bias force and tip Jacobian of one body at one state."""
        turn = rotation_matrix(position[3:7])
        joints, rates = position[7:].tolist(), velocity[6:].tolist()
        p, q, r = (turn.T @ velocity[3:6]).tolist()
        mass, bias = self.terms(body, joints, (p, q, r), rates, position[3:7])
        # velocity_bullet = to_bullet @ velocity
        to_bullet = np.eye(len(velocity))
        to_bullet[:6, :6] = np.block([[np.zeros((3, 3)), turn.T], [turn.T, np.zeros((3, 3))]])
        still = [0.0] * len(joints)
        linear, _ = pybullet.calculateJacobian(
            body,
            self._tip_link,
            self._tip_place,
            joints,
            still,
            still,
            physicsClientId=self._client,
        )
        tip = turn @ np.array(linear) @ to_bullet
        if self._fixed:
            tip[:, :6] = 0.0
            return mass, bias, tip
        return to_bullet.T @ mass @ to_bullet, to_bullet.T @ bias, tip
