"""Wrenches from outside that act on the links of some copies."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import arms
from cdcsr.simulation.arguments import as_floats, check_count
from cdcsr.simulation.rotations import rotation_matrix

Array = NDArray[np.float64]

_MOST_SLOTS = 16


class Loads:
    """Forces and torques on the J links of num copies; none at first. A link has S slots for them.

    Attributes:
        force: in the world frame, shape (num, J, S, 3), in [N].
        torque: in the world frame, shape (num, J, S, 3), in [N m].
        point: where each force acts, from the link's centre of mass, in the link's frame, shape
            (num, J, S, 3), in [m].
        active: whether any of them is not zero.
    """

    def __init__(self, robot: Robot, num: int) -> None:
        self._robot = robot
        self.force, self.torque, self.point = np.zeros((3, num, robot.num_links, 1, 3))
        self.active = False
        self._centers = np.array([link.center_of_mass for link, _ in robot.links])

    def set(
        self,
        ids: NDArray[np.int64],
        link: int,
        force: ArrayLike,
        torque: ArrayLike,
        point: ArrayLike | None,
        slot: int,
    ) -> None:
        """See :meth:`cdcsr.simulation.contract.Simulation.set_loads`."""
        num_links = len(self._centers)
        if not -num_links <= link < num_links:
            raise CdcsrError(
                f"There is no link {link}; links are numbered from 0 to {num_links - 1}, and -1 is "
                "the last one."
            )
        check_count("The slot of a load", slot, _MOST_SLOTS - 1, least=0)
        values = _vectors("force", force, len(ids)), _vectors("torque", torque, len(ids))
        offset = np.zeros(3)
        if point is not None:
            offset = _vectors("point", point, len(ids)) - (0, 0, self._centers[link])
        missing = max(0, slot + 1 - self.force.shape[2])
        self.force, self.torque, self.point = (
            np.pad(array, [(0, 0), (0, 0), (0, missing), (0, 0)])
            for array in (self.force, self.torque, self.point)
        )
        self.force[ids, link, slot], self.torque[ids, link, slot] = values
        self.point[ids, link, slot] = offset
        self.active = bool(self.force.any() or self.torque.any())

    def of_copies(self, ids: NDArray[np.int64] | slice) -> Loads:
        """Return the loads of some copies alone."""
        chosen = copy.copy(self)
        chosen.force, chosen.torque, chosen.point = (
            array[ids] for array in (self.force, self.torque, self.point)
        )
        return chosen

    def generalized(self, position: Array, ids: NDArray[np.int64]) -> Array:
        """Return the generalized force of the loads on copies `ids`.

        A hinge with the axis a through p feels a . (T + (x - p) x F) of each force F at x and
        torque T on the links beyond it; the base feels all forces, and their torques about its
        centre.

        Args:
            position: as in a Snapshot, shape (n, 7 + C + H).
            ids: n of the copies.

        Returns:
            In the contract's order of coordinates, shape (n, nv); zero for a fixed base.
        """
        robot = self._robot
        where, base = arms(robot, position[:, 7 + robot.num_cables :]), position[:, :3]
        turn = rotation_matrix(position[:, 3:7])
        axis, joint = (np.einsum("nab,nkb->nka", turn, part) for part in (where.axis, where.joint))
        turns = np.einsum("nab,njbc->njac", turn, where.turn)
        force, torque = self.of_copies(ids).at_centers(turns)
        torque += np.cross(joint[:, :-1] + self._centers[:, None] * turns[..., 2], force)
        # Sums over the links from each one to the tip; torques are about the base's centre.
        force, torque = (np.cumsum(part[:, ::-1], axis=1)[:, ::-1] for part in (force, torque))
        result = np.zeros((len(base), robot.num_coordinates))
        if robot.base.mount == "free":
            result[:, :3], result[:, 3:6] = force[:, 0], torque[:, 0]
        link = list(robot.link_of_hinge)
        about = torque[:, link] - np.cross(joint[:, link], force[:, link])
        result[:, 6 + robot.num_cables :] = np.einsum("nha,nha->nh", axis, about)
        return result

    def at_centers(self, turn: Array) -> tuple[Array, Array]:
        """Return the forces and torques that act alike at the links' centres of mass.

        Args:
            turn: how the links are turned in the world, shape (num, J, 3, 3).

        Returns:
            Two arrays of shape (num, J, 3).
        """
        arm = np.einsum("njab,njsb->njsa", turn, self.point)
        return self.force.sum(axis=2), (self.torque + np.cross(arm, self.force)).sum(axis=2)


def _vectors(name: str, value: ArrayLike, num: int) -> Array:
    """Return vectors for `num` copies, shape (num, 3)."""
    shape = (num, 3) if np.ndim(value) == 2 else (3,)
    return np.array(np.broadcast_to(as_floats(f"The {name} of a load", value, shape), (num, 3)))
