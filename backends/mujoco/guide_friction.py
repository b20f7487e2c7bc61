"""Friction of cables in their guides, as MuJoCo's dry friction of tendons.

From each place where a cable rubs a further tendon runs to the anchor. Its length changes as the
cable slides there, and its dry friction is the difference of the cable's tensions before and
behind the place. Before each step it is bounded by :mod:`cdcsr.simulation.capstan`.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from backends.mujoco.model import RIGID_SOLIMP, rigid_solref
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.capstan import Capstan

Array = NDArray[np.float64]


def add_friction(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add a tendon for each place where a cable rubs, in the order of :class:`Capstan`."""
    place, ends = Capstan(robot), routing(robot).joints
    for cable, joint in zip(place.cable.tolist(), place.joint.tolist(), strict=True):
        tendon = spec.add_tendon(
            name=f"rubs_{cable}_{joint}",
            frictionloss=0.0,
            solref_friction=rigid_solref(robot),
            solimp_friction=RIGID_SOLIMP,
            rgba=[0, 0, 0, 0],
        )
        tendon.wrap_site(f"guide_{cable}_{f'{joint - 1}_high' if joint else 'base'}")
        for link in range(joint, int(ends[cable])):
            tendon.wrap_site(f"guide_{cable}_{link}_low")
            tendon.wrap_site(f"guide_{cable}_{link}_high")
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON  # there are more of them than coordinates


class GuideFriction:
    """The friction of every copy in a persistent batch with the tendons of :func:`add_friction`.

    Attributes:
        bound: of the coming step, shape (num, R), in [N].
    """

    def __init__(self, robot: Robot, many: batch.Batch, hinges: Array) -> None:
        self._batch, self._hinges, self._capstan = many, hinges, Capstan(robot)
        self._cables = robot.num_cables
        self._coefficient = np.zeros((many.nsim, robot.num_cables))
        self.bound = many.expand("tendon_frictionloss")[:, robot.num_cables :]
        self._data = mujoco.MjData(many.model)

    def set_coefficient(self, ids: NDArray[np.int64], coefficient: Array) -> None:
        """Give the cables of copies `ids` coefficients of friction, shape (n, C)."""
        self._coefficient[ids] = coefficient
        self.bound[ids] *= (coefficient > 0)[:, self._capstan.cable]

    def bound_next(self, ids: NDArray[np.int64], tension: Array) -> None:
        """Set the bounds of the coming step of copies `ids`, which have made a step and nothing
        since.

        Args:
            ids: shape (n,).
            tension: of that step, shape (n, C), in [N].
        """
        force = np.zeros((len(ids), self.bound.shape[1]))
        for row, copy in enumerate(ids.tolist()):
            data = self._batch.get_data(copy, self._data)
            rubs = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON
            force[row, data.efc_id[rubs] - self._cables] = data.efc_force[rubs]
        self.bound[ids] = self._capstan.bounds(
            self._coefficient[ids], self._hinges[ids], tension, force
        )
