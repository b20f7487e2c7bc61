"""The equation of motion out of PyBullet's own functions, in the declared coordinates.

PyBullet's are [base angular, base linear, joints] in the base's frame, and neither the base's place
nor its linear velocity enters. So the body that is asked stays at the origin, and the base's rows
are turned here.
"""

from __future__ import annotations

import weakref

import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.client import connect, load_robot_body, set_masses
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_jacobian, cable_lengths, routing
from cdcsr.simulation.contract import Dynamics
from cdcsr.simulation.plant import Parameters, Plant
from cdcsr.simulation.rotations import rotation_matrix

Array = NDArray[np.float64]

_MOST_BODIES = 64
"""The largest number of bodies, each of 1 MB. Before there are more, the client is made anew,
because PyBullet remembers bodies that were removed."""


class Equation:
    """Evaluates the equation of motion of a robot at any state, in a PyBullet client of its own."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._bodies: dict[bytes, int] = {}
        self._open()
        self._route = routing(robot)
        self._num_cables = robot.num_cables
        last_link, _ = robot.links[-1]
        self._tip_link = robot.num_cables + robot.num_hinges - 1
        # calculateJacobian takes a point in the link's own frame, not from its centre of mass.
        self._tip_place = [0.0, 0.0, last_link.length]

    def __call__(self, position: Array, velocity: Array, plant: Plant | None = None) -> Dynamics:
        """The equation at some states.

        Args:
            position: as in a Snapshot, shape (n, 7 + C + 2 J).
            velocity: shape (n, nv).
            plant: the numbers of n copies; None for those of the description.
        """
        if plant is None:
            plant = Parameters().plant(self._robot, len(position))
        rows = [
            self._one(*state) for state in zip(self._chosen(plant), position, velocity, strict=True)
        ]
        mass, bias, tip = (np.stack(part) for part in zip(*rows, strict=True))
        joints, rates = position[:, 7:], velocity[:, 6:]
        passive = np.zeros_like(velocity)
        passive[:, 6:] = -plant.damping * rates
        passive[:, 6 + self._num_cables :] -= plant.stiffness * joints[:, self._num_cables :]
        cable = np.zeros((len(position), self._num_cables, velocity.shape[1]))
        travel, hinges = joints[:, : self._num_cables], joints[:, self._num_cables :]
        cable[..., 6:] = cable_jacobian(self._route, travel, hinges)
        length = cable_lengths(self._route, travel, hinges)
        return Dynamics(mass, bias, passive, tip, cable, velocity.copy(), length)

    def close(self) -> None:
        """Release the client; closing twice does nothing."""
        self._disconnect()

    def _open(self) -> None:
        self._bodies.clear()
        self._client = connect(self._robot)
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self._client)

    def _chosen(self, plant: Plant) -> list[int]:
        """The bodies with the masses in the rows of `plant`; one that was asked keeps its masses
        for ever."""
        masses = (plant.base_mass, plant.base_inertia, plant.link_mass, plant.link_inertia)
        keys = [
            b"".join(part[row].tobytes() for part in masses) for row in range(len(plant.base_mass))
        ]
        missing = set(keys) - self._bodies.keys()
        if missing and len(self._bodies) + len(missing) > _MOST_BODIES:
            self.close()
            self._open()
        for row, key in enumerate(keys):
            if key not in self._bodies:
                self._bodies[key] = load_robot_body(self._robot, self._client)
                set_masses(self._client, self._bodies[key], plant, row)
        return [self._bodies[key] for key in keys]

    def _one(self, body: int, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        """Mass matrix, bias force and tip Jacobian of one body at one state."""
        turn = rotation_matrix(position[3:7])
        joints, rates = position[7:].tolist(), velocity[6:].tolist()
        still = [0.0] * len(joints)
        # velocity_bullet = to_bullet @ velocity
        to_bullet = np.eye(len(velocity))
        to_bullet[:6, :6] = np.block([[np.zeros((3, 3)), turn.T], [turn.T, np.zeros((3, 3))]])
        mass = np.array(pybullet.calculateMassMatrix(body, joints, physicsClientId=self._client))
        bias = np.array(
            pybullet.calculateInverseDynamics(
                body,
                [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *joints],
                [*(turn.T @ velocity[3:6]).tolist(), 0.0, 0.0, 0.0, *rates],
                [0.0] * len(velocity),
                physicsClientId=self._client,
            )
        )
        # Unlike its arguments, the result has the base's linear part first.
        bias[:3], bias[3:6] = turn @ bias[:3], turn @ bias[3:6]
        linear, _ = pybullet.calculateJacobian(
            body,
            self._tip_link,
            self._tip_place,
            joints,
            still,
            still,
            physicsClientId=self._client,
        )
        return to_bullet.T @ mass @ to_bullet, bias, turn @ np.array(linear) @ to_bullet
