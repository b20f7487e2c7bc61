"""One copy of a robot in a PyBullet client: write and read its state, push its joints."""

from __future__ import annotations

from operator import add
from struct import Struct

import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.client import damp_and_clamp, load_robot_body, set_damping, set_masses
from backends.pybullet.options import PybulletOptions
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


class Body:
    """A robot that Bullet moves.

    Attributes:
        angles: positions of sliders and hinges when last read, in [m] and [rad].
        rates: their velocities, in [m/s] and [rad/s].
        turning: the base's angular velocity in its own frame, in [rad/s].
    """

    angles: tuple[float, ...]
    rates: tuple[float, ...]
    turning: Vector

    def __init__(self, robot: Robot, client: int, options: PybulletOptions) -> None:
        self._robot, self._client = robot, client
        self._body = load_robot_body(robot, client, robot.base.mount == "fixed", options.contact)
        damp_and_clamp(client, self._body, options.damping, options.max_joint_speed)
        self._sliders = range(robot.num_cables)
        self._joints = range(robot.num_cables + robot.num_hinges)
        # A third of the time that NumPy takes for a tuple.
        self._fill_position = Struct(f"{7 + len(self._joints)}d").pack_into
        self._fill_velocity = Struct(f"{6 + len(self._joints)}d").pack_into
        last_link, _ = robot.links[-1]
        self._above_center = last_link.length - last_link.center_of_mass

    def set_plant(self, plant: Plant, row: int) -> None:
        """Take masses and dampers from one row of `plant`."""
        set_masses(self._robot, self._client, self._body, plant, row)
        set_damping(self._client, self._body, plant, row)

    def write(self, position: Array, velocity: Array) -> None:
        """Set the state.

        Args:
            position: as a row of a Snapshot's, shape (7 + C + H,).
            velocity: shape (nv,).
        """
        values, speeds = position.tolist(), velocity.tolist()
        w, x, y, z = values[3:7]
        pybullet.resetBasePositionAndOrientation(
            self._body, values[:3], (x, y, z, w), physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(
            self._body, speeds[:3], speeds[3:6], physicsClientId=self._client
        )
        pybullet.resetJointStatesMultiDof(
            self._body,
            self._joints,
            [[q] for q in values[7:]],
            [[v] for v in speeds[6:]],
            physicsClientId=self._client,
        )

    def read(self, position: Array, velocity: Array) -> None:
        """Fill in the state; the shapes are those of :meth:`write`, and the arrays contiguous."""
        place, (x, y, z, w) = pybullet.getBasePositionAndOrientation(
            self._body, physicsClientId=self._client
        )
        linear, angular = pybullet.getBaseVelocity(self._body, physicsClientId=self._client)
        states = pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        self.angles, self.rates, _, _ = zip(*states, strict=True)
        before = position[3:7].tolist()
        if before[0] * w + before[1] * x + before[2] * y + before[3] * z < 0:
            w, x, y, z = -w, -x, -y, -z  # PyBullet's sign is arbitrary; ours does not jump
        # R^T v = v - 2 w (u x v) + 2 u x (u x v), where u is the quaternion's vector part.
        a, b, c = _cross((x, y, z), angular)
        d, e, f = _cross((x, y, z), (a, b, c))
        p, q, r = angular
        self.turning = p + 2 * (d - w * a), q + 2 * (e - w * b), r + 2 * (f - w * c)
        self._fill_position(position.data, 0, *place, w, x, y, z, *self.angles)
        self._fill_velocity(velocity.data, 0, *linear, *angular, *self.rates)

    def tip(self) -> tuple[float, ...]:
        """Return position and velocity of the tip, six numbers in [m] and [m/s]."""
        center, (x, y, z, w), _, _, _, _, moving, turning = pybullet.getLinkState(
            self._body,
            self._joints[-1],
            computeLinkVelocity=1,
            computeForwardKinematics=1,
            physicsClientId=self._client,
        )
        # The tip is above the last link's centre of mass, along its z axis.
        above = self._above_center
        along = 2 * above * (x * z + w * y), 2 * above * (y * z - w * x)
        arm = (*along, above * (1 - 2 * (x * x + y * y)))
        return (*map(add, center, arm), *map(add, moving, _cross(turning, arm)))

    def push(self, force: list[float]) -> None:
        """Apply forces to sliders and hinges in the next step, in [N] and [N m]."""
        pybullet.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.TORQUE_CONTROL,
            forces=force,
            physicsClientId=self._client,
        )

    def pull_base(self, place: list[float], force: list[float], torque: list[float]) -> None:
        """Apply a force at the base's centre, which is at `place` in [m], and a torque in the next
        step, in [N] and [N m], in the world frame."""
        # For a base PyBullet takes the frames of a torque the other way round.
        pybullet.applyExternalForce(
            self._body, -1, force, place, pybullet.WORLD_FRAME, physicsClientId=self._client
        )
        pybullet.applyExternalTorque(
            self._body, -1, torque, pybullet.WORLD_FRAME, physicsClientId=self._client
        )

    def drive(self, targets: list[float], strongest: list[float]) -> None:
        """Let Bullet's position motors drive the sliders to targets in [m], with at most so much
        force in [N]."""
        pybullet.setJointMotorControlArray(
            self._body,
            self._sliders,
            pybullet.POSITION_CONTROL,
            targetPositions=targets,
            forces=strongest,
            physicsClientId=self._client,
        )


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
