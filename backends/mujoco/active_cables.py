"""Cables as unilateral constraints on a batch: which of them hold in a step is found here, MuJoCo solves the rest.

MuJoCo sees a limit only once it is exceeded, and has no means to act on a cable that a step would tear past it: a
slack one whose slider is pulled with 250 N gets 6 mm too long. So each cable is an equality here, switched on in the
steps in which it pulls. Which ones those are is the solution of

    0 <= t   complementary to   length at the end of the step <= rest length,

and the equality, which ends the step at the rest length, has just the tension t. The set of the step before is the
first guess. Copies that find a cable pushing, or one let go that ends too long, take the step again with that cable
changed, until none is wrong; along demonstrations 3 % of the steps are taken twice. The answer does not depend on the
guess, and nothing but the tensions has changed, so they act on slider and arm alike and no momentum is made.

Dampers must be implicit in the solver and not only in the integrator, or the accelerations asked for are not those
that come out: see :func:`stepping_spec`.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from backends.mujoco.model import build_spec
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing

Array = NDArray[np.float64]

CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)
"""Positions, velocities and their sensors are made current after each step. In a persistent batch the next step
starts from them, so this costs nothing."""
_TOO_LONG = 5e-6
"""A free cable that ends a step longer than at rest by more than this (in [m]) should have been held."""
_PUSHING = 1e-3
"""A held cable that pushes by more than this (in [N]) should have been free."""
_EXCESS = 5e-5
"""What a cable is too long by (in [m]) is taken back at once, or if it is more than this with the recovery time.
Steps leave less, from the curvature of the motion; more comes from a state or a rest length set from outside."""
_TOGETHER = 4
"""Tries that change all wrong cables at once. No step was seen to need more than two, but they may go round in circles;
later ones change only the first wrong cable, which never does (Murty's rule, for positive definite matrices)."""


def stepping_spec(robot: Robot) -> mujoco.MjSpec:
    """The model that a batch steps with: of the same robot, and with dampers implicit in M + h C.

    The armature h c on every damped joint is their matrix, where the constraint solver sees it too: (M + h C) a = f
    - C v + ... is then an explicit (semi-implicit Euler) step. MuJoCo's implicit integrators solve the constraints
    with M, but move with M + h C.
    """
    spec = build_spec(robot)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    for joint in spec.joints:
        joint.armature = robot.time_step * float(np.ravel(joint.damping)[0])
    for tendon, equality in zip(spec.tendons, spec.equalities, strict=True):
        tendon.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        equality.active = True
    return spec


class Cables:
    """The cables of every copy in a persistent batch of models from :func:`stepping_spec`.

    Attributes:
        tension: of the last step, shape (num, C), in [N], never negative; zero until the next one for copies that
            were set to something new.
    """

    def __init__(self, robot: Robot, many: batch.Batch) -> None:
        route, cables = routing(robot), robot.num_cables
        self.tension = np.zeros((many.nsim, cables))
        self._batch, self._before, self._slider_offset = (
            many,
            many.state.copy(),
            route.slider_offset,
        )
        self._rest = np.tile(route.rest_length, (many.nsim, 1))
        self._described_rest = route.rest_length
        self._target = many.expand("eq_data")[:, :, 0]
        """(num, C) where equalities end a step, as the length beyond the description's rest length, in [m]."""
        self._recovering = False
        self._keep = 1 - robot.time_step / robot.constraint.recovery_time
        self._length, self._held = many.bind("ten_length"), many.bind("eq_active")
        self._travel = many.bind("qpos")[:, 7 : 7 + cables]
        self._push = many.bind("qfrc_constraint")[:, 6 : 6 + cables]

    def set_rest_length(self, ids: NDArray[np.int64], offset: Array) -> None:
        """Make cables of copies `ids` longer than described by `offset`, shape (len(ids), C), in [m]."""
        self._rest[ids] = self._described_rest + offset
        self._target[ids] = offset

    def step(self) -> None:
        """Advance all copies by one time step under the controls in the batch."""
        many, end = self._batch, self._aim()
        before = self._before
        before[:] = many.state
        # The constraints' force on a slider is its own cable's tension: upward as long as it is below the first guide.
        side = np.sign(self._slider_offset - self._travel)
        too_long = end + _TOO_LONG
        many.step(stage=CURRENT)
        pull = self._push * side
        # More tries than these only happen if curvature makes a cable seem wrong both ways; then either will do.
        for tries in range(_TOGETHER + 2 * end.shape[1]):
            wrong = np.where(self._held, pull < -_PUSHING, self._length > too_long)
            if not wrong.any():
                break
            ids = np.flatnonzero(wrong.any(axis=1))
            if tries >= _TOGETHER:
                wrong &= wrong.cumsum(axis=1) == 1
            held = (self._held[ids] != 0) ^ wrong[ids]
            many.state[ids] = before[ids]
            self._held[ids] = held
            many.forward(ids, stage=CURRENT)
            many.step(ids, stage=CURRENT)
            pull = self._push * side
        np.maximum(pull, 0, out=self.tension)

    def _aim(self) -> Array:
        """Set what cables that are to hold end the coming step at; returns these lengths, shape (num, C), in [m]."""
        excess = self._length - self._rest
        if not (self._recovering or excess.max() > _EXCESS):
            return self._rest
        left = np.where(excess > _EXCESS, self._keep * excess, 0.0)
        target = self._rest - self._described_rest + left
        late = (self._target != target).any(axis=1)
        self._target[:] = target
        self._batch.forward(np.flatnonzero(late), stage=CURRENT)
        self._recovering = bool(left.any())
        return self._rest + left


class Limits:
    """The cables of every copy as MuJoCo has them by itself: limits of tendons; in place of :class:`Cables`.

    Attributes:
        tension: as there.
    """

    def __init__(self, robot: Robot, many: batch.Batch) -> None:
        cables = robot.num_cables
        self.tension = np.zeros((many.nsim, cables))
        self._batch, self._slider_offset = many, routing(robot).slider_offset
        self._travel = many.bind("qpos")[:, 7 : 7 + cables]
        self._push = many.bind("qfrc_constraint")[:, 6 : 6 + cables]

    def set_rest_length(self, ids: NDArray[np.int64], offset: Array) -> None:
        """Make cables of copies `ids` longer than described by `offset`, shape (len(ids), C), in [m]."""
        self._batch.expand("tendon_range")[ids, :, 1] = (
            self._batch.model.tendon_range[:, 1] + offset
        )

    def step(self) -> None:
        """Advance all copies by one time step under the controls in the batch."""
        side = np.sign(self._slider_offset - self._travel)
        self._batch.step(stage=CURRENT)
        np.maximum(self._push * side, 0, out=self.tension)
