"""The equation of motion out of PyBullet's own functions, in the declared coordinates.

PyBullet's are [base angular, base linear, joints] in the base's frame, and neither the base's place nor its
linear velocity enters. So the body that is asked stays at the origin, and the base's rows are turned here.
"""

from __future__ import annotations

import weakref

import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.loading import connect, load_robot_body
from cdcsr.cables import cable_jacobian, cable_lengths, routing
from cdcsr.robot import Robot
from cdcsr.simulation import Dynamics, rotation_matrix

Array = NDArray[np.float64]


class Equation:
    """Evaluates the equation of motion of a robot at any state, in a PyBullet client of its own."""

    def __init__(self, robot: Robot) -> None:
        self._client = connect(robot)
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self._client)
        self._body = load_robot_body(robot, self._client)
        self._route = routing(robot)
        self._num_cables = robot.num_cables
        last_link, _ = robot.links[-1]
        self._tip_link = robot.num_cables + robot.num_hinges - 1
        # calculateJacobian takes a point in the link's own frame, not from its centre of mass.
        self._tip_place = [0.0, 0.0, last_link.length]
        hinges = [joint for _, joint in robot.links for _ in range(2)]
        self._stiffness = np.array([0.0] * robot.num_cables + [joint.stiffness for joint in hinges])
        damping = [servo.damping for servo in robot.servos] + [joint.damping for joint in hinges]
        self._damping = np.array(damping)

    def __call__(self, position: Array, velocity: Array) -> Dynamics:
        """The equation at some states.

        Args:
            position: as in a Snapshot, shape (n, 7 + C + 2 J).
            velocity: shape (n, nv).
        """
        rows = [self._one(p, v) for p, v in zip(position, velocity, strict=True)]
        mass, bias, tip = (np.stack(part) for part in zip(*rows, strict=True))
        joints, rates = position[:, 7:], velocity[:, 6:]
        passive = np.zeros_like(velocity)
        passive[:, 6:] = -self._stiffness * joints - self._damping * rates
        cable = np.zeros((len(position), self._num_cables, velocity.shape[1]))
        travel, hinges = joints[:, : self._num_cables], joints[:, self._num_cables :]
        cable[..., 6:] = cable_jacobian(self._route, travel, hinges)
        length = cable_lengths(self._route, travel, hinges)
        return Dynamics(mass, bias, passive, tip, cable, velocity.copy(), length)

    def close(self) -> None:
        """Release the client; closing twice does nothing."""
        self._disconnect()

    def _one(self, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        """Mass matrix, bias force and tip Jacobian at one state."""
        turn = rotation_matrix(position[3:7])
        joints, rates = position[7:].tolist(), velocity[6:].tolist()
        still = [0.0] * len(joints)
        # velocity_bullet = to_bullet @ velocity
        to_bullet = np.eye(len(velocity))
        to_bullet[:6, :6] = np.block([[np.zeros((3, 3)), turn.T], [turn.T, np.zeros((3, 3))]])
        mass = np.array(pybullet.calculateMassMatrix(self._body, joints, physicsClientId=self._client))
        bias = np.array(
            pybullet.calculateInverseDynamics(
                self._body,
                [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *joints],
                [*(turn.T @ velocity[3:6]).tolist(), 0.0, 0.0, 0.0, *rates],
                [0.0] * len(velocity),
                physicsClientId=self._client,
            )
        )
        # Unlike its arguments, the result has the base's linear part first.
        bias[:3], bias[3:6] = turn @ bias[:3], turn @ bias[3:6]
        linear, _ = pybullet.calculateJacobian(
            self._body, self._tip_link, self._tip_place, joints, still, still, physicsClientId=self._client
        )
        return to_bullet.T @ mass @ to_bullet, bias, turn @ np.array(linear) @ to_bullet
