"""Wrenches from outside that act on the links of some copies."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.arguments import as_floats, check_count

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

    def of_copies(self, ids: NDArray[np.int64]) -> Loads:
        """Return the loads of some copies alone."""
        chosen = copy.copy(self)
        chosen.force, chosen.torque, chosen.point = (
            array[ids] for array in (self.force, self.torque, self.point)
        )
        return chosen

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
