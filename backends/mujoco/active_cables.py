"""Cables as unilateral constraints on a batch. An active-set method finds which cables pull in a
step; MuJoCo solves the rest.

MuJoCo sees a limit only once it is exceeded, and cannot act on a cable that becomes taut within a
step: a slack cable whose slider is pulled with 250 N gets 6 mm too long. Here each cable is an
equality instead, which is active in the steps in which the cable pulls. The active set solves

    0 <= t   complementary to   length at the end of the step <= rest length,

where t is the tension: an active equality ends the step at the rest length, and its force is t. The
first guess is the active set of the step before. A copy in which an active cable pushes, or a free
one ends too long, takes the step again with those cables changed, until no cable is wrong. Along
demonstrations 3 % of the steps are taken twice. The result does not depend on the guess. Each
tension acts on slider and arm alike, so the cables create no momentum.

Dampers must be implicit in the constraint solver too, and not only in the integrator; otherwise the
accelerations that the solver asks for are not those of the step: see :func:`stepping_spec`.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from backends.mujoco.guide_friction import GuideFriction, add_friction
from backends.mujoco.model import RIGID_SOLIMP, TOUCH, UNLIMITED, build_spec, rigid_solref
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.plant import Parameters, Plant

Array = NDArray[np.float64]

CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)
"""MuJoCo updates positions, velocities and their sensors after each step. In a persistent batch the
next step starts from them, so this costs nothing."""
_TOO_LONG = 5e-6
"""A free cable that ends a step longer than at rest by more than this, in [m], should have been
active."""
_PUSHING = 1e-3
"""An active cable that pushes by more than this, in [N], should have been free."""
_EXCESS = 5e-5
"""A step takes back an excess length up to this, in [m], at once, and a larger one with the
recovery time. A step leaves less than this, by the curvature of the motion; more comes from a state
or a rest length that was set from outside."""
_STIFFEST = 2.0
"""An explicit spring k between masses of the inverse 1/m shakes where h^2 k / m is above 4."""
_MOST_ITERATIONS = 5000
_TOGETHER = 4
"""The number of tries that change all wrong cables at once. No step was seen to need more than two,
but such tries can cycle. Later ones change only the first wrong cable; for positive definite
matrices this never cycles (Murty's least-index rule)."""


def stepping_spec(robot: Robot, friction: bool = False) -> mujoco.MjSpec:
    """Build the model that a batch steps with: the same robot, with dampers implicit in M + h C.

    Every joint with damping c gets the armature h c, where h is the time step. The armatures are
    the matrix h C, and the constraint solver sees them too: then (M + h C) a = f - C v + ... is an
    explicit step of semi-implicit Euler. MuJoCo's implicit integrators would solve the constraints
    with M, but move with M + h C.

    Args:
        robot: the description.
        friction: whether cables can rub in their guides.
    """
    spec = build_spec(robot)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    # The solver ends long before, but where a taut cable holds its slider against the stop.
    spec.option.iterations = _MOST_ITERATIONS
    for joint in spec.joints:
        joint.armature = robot.time_step * float(np.ravel(joint.damping)[0])
    for tendon in spec.tendons:
        tendon.limited, tendon.stiffness = mujoco.mjtLimited.mjLIMITED_FALSE, [0, 0, 0]
    for equality in spec.equalities:  # of tendons and of coupled hinges
        equality.active = True
        equality.solref, equality.solimp = rigid_solref(robot), RIGID_SOLIMP
    if friction:
        add_friction(spec, robot)
    return spec


class Cables:
    """The cables of every copy in a persistent batch of models from :func:`stepping_spec`.

    Attributes:
        tension: in the last step, shape (num, C), in [N], never negative; zero for copies that were
            reset or placed since.
        friction: in the guides, if the model has it.
    """

    def __init__(self, robot: Robot, many: batch.Batch) -> None:
        route, cables = routing(robot), robot.num_cables
        self.tension = np.zeros((many.nsim, cables))
        self._batch, self._before = many, many.state.copy()
        self._slider_offset = route.slider_offset
        self._rest = np.repeat(route.rest_length[None], many.nsim, axis=0)  # never a view
        self._described_rest, self._bent = route.rest_length, route.bent
        self._target = many.expand("eq_data")[:, :cables, 0]
        """Where active equalities end a step, shape (num, C), in [m] beyond the length along the
        straight arm."""
        self._target[:] = route.bent
        self._recovering = False
        self._keep = 1 - robot.time_step / robot.constraint.recovery_time
        self._length = many.bind("ten_length")[:, :cables]
        self._held = many.bind("eq_active")[:, :cables]
        self._travel, self._push, self._stop = _sliders(robot, many)
        hinges, self.friction = many.bind("qpos")[:, base_size(robot)[0] + cables :], None
        if many.model.ntendon > cables:
            self.friction = GuideFriction(robot, many, hinges)
        self._step, self._compliance = robot.time_step, np.zeros_like(self.tension)
        self._elastic = False
        plant = Parameters().plant(robot, many.nsim)
        if plant.cable_compliance.any() or plant.guide_friction.any():
            self.set_plant(np.arange(many.nsim), plant)

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give the cables of copies `ids` the numbers in the rows of `plant`; their masses must be
        set before."""
        if self.friction is not None:
            self.friction.set_coefficient(ids, plant.guide_friction)
        self._rest[ids] = self._described_rest + plant.rest_length_offset
        self._target[ids] = self._bent + plant.rest_length_offset
        if self._elastic or plant.cable_compliance.any():
            self._compliance[ids] = plant.cable_compliance
            self._elastic = bool(self._compliance.any())
            self._soften(ids)

    def _soften(self, ids: NDArray[np.int64]) -> None:
        """Let active equalities end a step as springs.

        MuJoCo solves A f + R f = b for the forces f = -t. With the softness of
        :func:`backends.mujoco.model.build_spec` and R = c / h^2, this is the equation of a cable
        that ends the step longer than at rest by c t. In MuJoCo R = w (1 - d) / d, where w is the
        inverse weight of the tendon and d the impedance: so d is 1/2, and w is c / h^2.
        """
        many, model = self._batch, self._batch.model
        cables = self._compliance.shape[1]
        soft = self._compliance[ids] > 0
        impedance = np.where(soft, 0.5, model.eq_solimp[:cables, 0])
        stiff = np.stack([impedance / self._step**2, impedance / self._step], axis=-1)
        described = model.tendon_invweight0[:cables]
        rigid = (1 - model.eq_solimp[:cables, 0]) * described
        weight = np.maximum(self._compliance[ids] / self._step**2, rigid)
        many.expand("tendon_invweight0")[ids, :cables] = np.where(soft, weight, described)
        many.expand("eq_solimp")[ids, :cables, :2] = impedance[..., None]
        many.expand("eq_solref")[ids, :cables] = np.where(
            soft[..., None], -stiff, model.eq_solref[:cables]
        )

    def step(self) -> None:
        """Advance all copies by one time step under the controls in the batch."""
        many, end = self._batch, self._aim()
        before = self._before
        before[:] = many.state
        bounds = None if self.friction is None else self.friction.bound.copy()
        # The constraint force on a slider is the tension of its own cable, upward while the slider
        # is below the first guide; that of its stop is downward.
        side = np.sign(self._slider_offset - self._travel)
        too_long = end + _TOO_LONG
        pull = self._advance(side)
        # The limit is only reached if curvature makes a cable seem wrong both ways; then either
        # will do.
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
            if self.friction is not None and bounds is not None:
                self.friction.bound[ids] = bounds[ids]
            many.forward(ids, stage=CURRENT)
            pull = self._advance(side, ids)
        np.maximum(pull, 0, out=self.tension)

    def _advance(self, side: Array, ids: NDArray[np.int64] | None = None) -> Array:
        """Let copies, by default all, make a step.

        Returns:
            The force of every active cable in [N], shape (num, C); negative where one pushes.
        """
        many = self._batch
        if self.friction is None:
            many.step(ids, stage=CURRENT)
        else:
            many.step(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
            chosen = np.arange(len(side)) if ids is None else ids
            pull = ((self._push + self._stop) * side)[chosen]
            self.friction.bound_next(chosen, np.maximum(pull, 0))
            many.forward(ids, stage=CURRENT)
        return (self._push + self._stop) * side

    def _aim(self) -> Array:
        """Set the lengths at which active cables end the coming step, and return them.

        Returns:
            Shape (num, C), in [m].
        """
        excess = self._length - self._rest
        if self._elastic:  # what is longer is a spring
            excess[self._compliance > 0] = 0.0
        if not (self._recovering or excess.max(initial=0) > _EXCESS):
            return self._rest
        left = np.where(excess > _EXCESS, self._keep * excess, 0.0)
        target = self._rest - self._described_rest + left + self._bent
        late = (self._target != target).any(axis=1)
        self._target[:] = target
        self._batch.forward(np.flatnonzero(late), stage=CURRENT)
        self._recovering = bool(left.any())
        return self._rest + left


class Limits:
    """The cables of every copy as stock MuJoCo has them: soft limits of tendons.

    Attributes:
        tension: as in :class:`Cables`, which this can replace.
        friction: none.
    """

    friction = None

    def __init__(self, robot: Robot, many: batch.Batch) -> None:
        cables = robot.num_cables
        self.tension = np.zeros((many.nsim, cables))
        route = routing(robot)
        self._batch, self._slider_offset = many, route.slider_offset
        self._described_rest, self._step = route.rest_length - TOUCH, robot.time_step
        self._rest, self._stiffness = np.zeros((2, many.nsim, cables))
        self._elastic, self._length = False, many.bind("ten_length")
        plant = Parameters().plant(robot, many.nsim)
        if plant.cable_compliance.any():
            self.set_plant(np.arange(many.nsim), plant)
        self._travel, self._push, self._stop = _sliders(robot, many)

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give the cables of copies `ids` the numbers in the rows of `plant`.

        Raises:
            CdcsrError: the time step is too long for the spring of an elastic cable.
        """
        many, compliance = self._batch, plant.cable_compliance
        rest, soft = self._described_rest + plant.rest_length_offset, compliance > 0
        many.expand("tendon_range")[ids, :, 1] = np.where(soft, UNLIMITED, rest)
        if not (self._elastic or soft.any()):
            return
        stiffness = np.divide(1, compliance, out=np.zeros_like(compliance), where=soft)
        sharpest = (stiffness * many.model.tendon_invweight0).max()
        if self._step**2 * sharpest > _STIFFEST:
            raise CdcsrError(
                "MuJoCo's tendon springs are explicit: these elastic cables need a time_step of at "
                f"most {np.sqrt(_STIFFEST / sharpest):.2g} s; the engine mujoco has no such limit."
            )
        many.expand("tendon_lengthspring")[ids] = np.stack([np.zeros_like(rest), rest], axis=-1)
        many.expand("tendon_stiffness")[ids] = stiffness
        self._rest[ids], self._stiffness[ids] = rest, stiffness
        self._elastic = bool(self._stiffness.any())

    def step(self) -> None:
        """Advance all copies by one time step under the controls in the batch."""
        side = np.sign(self._slider_offset - self._travel)
        springs = 0.0
        if self._elastic:  # an explicit spring pulls by its length at the beginning of the step
            springs = self._stiffness * np.maximum(self._length - self._rest, 0)
        self._batch.step(stage=CURRENT)
        np.maximum((self._push + self._stop) * side, 0, out=self.tension)
        self.tension += springs


def base_size(robot: Robot) -> tuple[int, int]:
    """Return how many numbers of qpos and of qvel belong to the base."""
    return (7, 6) if robot.base.mount == "free" else (0, 0)


def _sliders(robot: Robot, many: batch.Batch) -> tuple[Array, Array, Array]:
    """Return the sliders' part of the positions and of the constraint forces, and the part of these
    that their stops have."""
    (q, v), cables = base_size(robot), robot.num_cables
    push, sensors = many.bind("qfrc_constraint")[:, v : v + cables], many.bind("sensordata")
    return many.bind("qpos")[:, q : q + cables], push, sensors[:, sensors.shape[1] - cables :]
