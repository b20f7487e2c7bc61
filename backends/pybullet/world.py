"""Copies of a robot that are stepped together in this process."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from typing import NamedTuple

import numba
import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.cables import joint_forces, rig
from backends.pybullet.client import connect, load_robot_body, set_masses
from backends.pybullet.dynamics import chain
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Parameters, Plant

Array = NDArray[np.float64]

MAX_TURN = 0.5
"""A copy has diverged if a hinge or its base turns by more than this in one step, in [rad]."""
COPIES_PER_CLIENT = 4
"""The time of PyBullet's step grows with the square of the bodies in a client, and a client takes
27 MB."""


class Divergence(NamedTuple):
    """A copy that has diverged."""

    copy: int
    time: float
    """The simulated time of the copy, in [s]."""
    what: str
    """The cause, for the message."""


class World:
    """`num` copies of a robot, all straight and at rest at the start.

    Attributes:
        time: shape (num,), in [s].
        position: as in a Snapshot, shape (num, 7 + C + 2 J).
        velocity: shape (num, nv).
        tension: of the step just made, shape (num, C), in [N].
    """

    def __init__(self, robot: Robot, num: int) -> None:
        self._clients: list[int] = []
        self._disconnect = weakref.finalize(self, _disconnect, self._clients)
        self._bodies: list[tuple[int, int]] = []
        for copy in range(num):
            if copy % COPIES_PER_CLIENT == 0:
                self._clients.append(connect(robot))
            self._bodies.append((self._clients[-1], load_robot_body(robot, self._clients[-1])))
        self._joints = range(robot.num_cables + robot.num_hinges)
        self._chain, self._rig = chain(robot), rig(robot)
        self._plant = Parameters().plant(robot, num)
        self._time_step = robot.time_step
        self.time = np.zeros(num)
        self.position = np.zeros((num, 7 + len(self._joints)))
        self.position[:, 3] = 1.0
        self.velocity = np.zeros((num, robot.num_coordinates))
        self.tension = np.zeros((num, robot.num_cables))
        self._force = np.zeros((num, len(self._joints)))
        self._fastest = np.full(robot.num_coordinates, MAX_TURN / robot.time_step)
        self._fastest[:3] = robot.arm_length / robot.time_step
        self._fastest[6 : 6 + robot.num_cables] = robot.arm_length / robot.time_step

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give copies `ids` the numbers in the rows of `plant`."""
        for mine, new in zip(self._plant, plant, strict=True):
            mine[ids] = new
        for row, copy in enumerate(ids.tolist()):
            client, body = self._bodies[copy]
            set_masses(client, body, plant, row)

    def reset(self, ids: Iterable[int]) -> None:
        """Put copies back to the start."""
        travel = self._plant.start_travel
        for copy in ids:
            self.time[copy] = 0.0
            self.position[copy] = 0.0
            self.position[copy, 3] = 1.0
            self.position[copy, 7 : 7 + travel.shape[1]] = travel[copy]
            self.velocity[copy] = 0.0
            self.tension[copy] = 0.0
            self._write(copy)

    def place(
        self,
        ids: NDArray[np.int64],
        time: Array,
        position: Array,
        velocity: Array,
        tension: Array,
    ) -> None:
        """Put copies `ids` into a state: rows of the attributes."""
        self.time[ids], self.tension[ids] = time, tension
        self.position[ids], self.velocity[ids] = position, velocity
        for copy in ids.tolist():
            self._write(copy)
            self._read(copy)

    def step(self, command: Array, substeps: int) -> list[Divergence]:
        """Advance all copies.

        Args:
            command: servo set-points, shape (num, C), in [m].
            substeps: how many time steps.

        Returns:
            The copies that diverged, in order. They are back at the start; the others have made all
            substeps.
        """
        lost: dict[int, Divergence] = {}
        for _ in range(substeps):
            joint_forces(
                self._chain,
                self._rig,
                self._plant,
                self.position,
                self.velocity,
                command,
                self.tension,
                self._force,
            )
            for (client, body), force in zip(self._bodies, self._force.tolist(), strict=True):
                pybullet.setJointMotorControlArray(
                    body,
                    self._joints,
                    pybullet.TORQUE_CONTROL,
                    forces=force,
                    physicsClientId=client,
                )
            for client in self._clients:
                pybullet.stepSimulation(physicsClientId=client)
            self.time += self._time_step
            for copy in range(len(self._bodies)):
                self._read(copy)
            if not _within(self.velocity, self._fastest):
                for copy in np.flatnonzero(
                    ~(np.abs(self.velocity) <= self._fastest).all(axis=1)
                ).tolist():
                    lost.setdefault(
                        copy, Divergence(copy, float(self.time[copy]), self._complaint(copy))
                    )
                    self.reset([copy])
        self.reset(lost)
        return [lost[copy] for copy in sorted(lost)]

    def close(self) -> None:
        """Release the clients; to close twice does nothing."""
        self._disconnect()

    def _complaint(self, copy: int) -> str:
        speed = np.abs(self.velocity[copy])
        if not np.isfinite(speed).all():
            return "velocities are no longer finite"
        worst = int(np.argmax(speed / self._fastest))
        limit = f"too fast for a step of {self._time_step:g} s"
        return f"coordinate {worst} moves at {speed[worst]:.3g}, {limit}"

    def _write(self, copy: int) -> None:
        """Give PyBullet the position and velocity of a copy."""
        client, body = self._bodies[copy]
        position, velocity = self.position[copy].tolist(), self.velocity[copy].tolist()
        w, x, y, z = position[3:7]
        pybullet.resetBasePositionAndOrientation(
            body, position[:3], (x, y, z, w), physicsClientId=client
        )
        pybullet.resetBaseVelocity(body, velocity[:3], velocity[3:6], physicsClientId=client)
        pybullet.resetJointStatesMultiDof(
            body,
            self._joints,
            [[q] for q in position[7:]],
            [[v] for v in velocity[6:]],
            physicsClientId=client,
        )

    def _read(self, copy: int) -> None:
        """Take the position and velocity of a copy from PyBullet."""
        (client, body), position = self._bodies[copy], self.position[copy]
        place, (x, y, z, w) = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
        linear, angular = pybullet.getBaseVelocity(body, physicsClientId=client)
        angles, rates, _, _ = zip(
            *pybullet.getJointStates(body, self._joints, physicsClientId=client), strict=True
        )
        if position[3] * w + position[4] * x + position[5] * y + position[6] * z < 0:
            w, x, y, z = -w, -x, -y, -z  # PyBullet's sign is arbitrary; ours does not jump
        position[:] = (*place, w, x, y, z, *angles)
        self.velocity[copy] = (*linear, *angular, *rates)


def _disconnect(clients: list[int]) -> None:
    for client in clients:
        pybullet.disconnect(physicsClientId=client)


@numba.njit(cache=True)
def _within(velocity: Array, fastest: Array) -> bool:
    """Whether every coordinate of every copy is a number and no faster than allowed."""
    for row in velocity:
        for k in range(row.size):
            if not abs(row[k]) <= fastest[k]:
                return False
    return True
