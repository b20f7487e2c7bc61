"""Copies of a robot in the memory of a device, stepped by MuJoCo Warp.

The model is that of the engine `mujoco` with two differences. Each cable is a limit of a tendon
that is always exceeded, so that its row is in every step, and :func:`.kernels.aim_cables` says what
the row asks for. Then Newton's solver finds which cables pull, together with their forces: one
solve gives what the engine `mujoco` finds by an active-set method.

A step ends with positions, velocities and all that follows from them up to date, so that the next
one starts with forces.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from backends.mujoco.active_cables import base_size, stepping_spec
from backends.mujoco.copies import MASSES, plant_fields
from backends.mujoco.model import RIGID_SOLIMP, rigid_solref
from backends.warp import kernels
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing
from cdcsr.robot.stability import highest_speeds
from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Parameters, Plant

# Warp has no types for checkers: its arrays are Any here.
Warp = Any
Array = NDArray[np.float64]

_ALWAYS = [-2.0, -1.0]
"""A range that every length exceeds, in [m]."""
_ITERATIONS = 50
"""Newton's solver took at most 8 iterations in the steps that were looked at."""
_DERIVED = ("body_subtreemass", "dof_invweight0", "tendon_invweight0")
"""The numbers of the model that follow from masses and that a step reads."""
_one_at_a_time = threading.RLock()
"""Warp keeps its current device for the process and not for a thread."""


def choose_device(asked: str) -> Warp:
    """Return the device of a name: cpu, cuda, cuda:N, or auto for a GPU if there is one.

    Raises:
        CdcsrError: there is no such device.
    """
    wp.init()
    found = [device.alias for device in wp.get_devices()]
    if asked == "auto":
        asked = "cuda" if wp.is_cuda_available() else "cpu"
    if asked == "cuda" and wp.is_cuda_available():
        return wp.get_cuda_device()
    if asked not in found:
        raise CdcsrError(f"Warp finds no device {asked} here; there is {', '.join(found)}.")
    return wp.get_device(asked)


class Copies:
    """`num` copies on a device.

    All arrays have the copy as first axis and are in single precision; `time` is in double.

    Attributes:
        host: the model, in MuJoCo.
        model: the model on the device.
        data: MuJoCo Warp's arrays, qpos and qvel among them; angular velocity of the base is in its
            own frame.
        tension: shape (num, C), in [N].
        tip: world frame, shape (num, 3), in [m].
        tip_velocity: world frame, shape (num, 3), in [m/s].
        base_turning: angular velocity of the base, world frame, shape (num, 3), in [rad/s].
        time: shape (num,), in [s].
        diverged: whether a copy has diverged since it was put to a state, shape (num,).
        culprit: the coordinate that showed it, in the order of qvel, shape (num,).
        speed: the velocity of this coordinate, shape (num,).
    """

    def __init__(self, robot: Robot, num: int, device: Warp) -> None:
        self.num, self.device = num, device
        self.host = _spec(robot).compile()
        self._robot, self._graphs = robot, dict[str, Warp]()
        self._rows = robot.num_cables + self.host.neq + int(self.host.jnt_limited.sum())
        base, _ = base_size(robot)
        self._sliders = slice(base, base + robot.num_cables)
        self._described = np.tile(routing(robot).rest_length, (num, 1))
        start = np.tile(self.host.qpos0, (num, 1))
        start[:, self._sliders.stop :] = robot.start_angles
        self._tip, self._first_link = self.host.site("tip").id, self.host.body("link_0").id
        self._keep = 1 - robot.time_step / robot.constraint.recovery_time
        self._step = robot.time_step
        with self.active():
            self.model = mjw.put_model(self.host)
            self.model.opt.run_collision_detection, self.model.opt.warn_overflow = False, 0
            self.data = mjw.make_data(self.host, nworld=num, nconmax=0, njmax=self._rows)
            self._start, self._rest = _floats(start), _floats(self._described)
            self._still = _floats(np.zeros((num, self.host.nv)))
            self._own_start: tuple[Warp, Warp] | None = None
            self._fastest = _floats(highest_speeds(robot)[-self.host.nv :])
            self._compliance, self.tension = (_floats(0 * self._described) for _ in range(2))
            self.tip, self.tip_velocity, self.base_turning = (
                wp.zeros(num, dtype=wp.vec3) for _ in range(3)
            )
            self.time = wp.zeros(num, dtype=wp.float64)
            self.diverged, self.chosen = (wp.zeros(num, dtype=wp.bool) for _ in range(2))
            self.culprit, self.speed = wp.zeros(num, dtype=wp.int32), wp.zeros(num, dtype=float)
            self._loads: list[Warp] = []

    @contextmanager
    def active(self) -> Iterator[None]:
        """Let Warp work on this device."""
        with _one_at_a_time, wp.ScopedDevice(self.device):
            yield

    def step(self, restart: bool = False) -> None:
        """Advance all copies by one time step under the controls in `data`.

        Args:
            restart: then put the copies in `chosen` to the start; a restart apart would bring all
                that follows from positions up to date a second time, for all copies.
        """
        self._do(f"step {bool(self._loads)} {restart}", partial(self._advance, restart))

    def forward(self) -> None:
        """Bring all that follows from positions and velocities up to date."""
        self._do("forward", self._update)

    def restart(self) -> None:
        """Put the copies in `chosen` to the start."""
        self._do("restart", self._restart)

    def start_at(self, position: Warp, velocity: Warp) -> None:
        """Let the start be what two arrays hold at that time, as qpos and qvel."""
        self._own_start = position, velocity
        self._graphs.clear()

    def plant_arrays(self) -> dict[str, Warp]:
        """Return the arrays that :meth:`set_plant` changes, which have a row for every copy."""
        described = plant_fields(self.host, Parameters().plant(self._robot, 1))
        fields = {name: self._own(name) for name in (*described, *_DERIVED)}
        return fields | {"start": self._start, "rest": self._rest, "soft": self._compliance}

    def _do(self, name: str, work: Callable[[], None]) -> None:
        """Launch kernels; on a GPU as one graph, from the second time on.

        The first time they must be loaded, which a graph cannot do.
        """
        if name in self._graphs:
            wp.capture_launch(self._graphs[name])
            return
        work()
        if self.device.is_cuda:
            with wp.ScopedCapture() as capture:
                work()
            self._graphs[name] = capture.graph

    def _advance(self, restart: bool) -> None:
        data, efc = self.data, self.data.efc
        if self._loads:
            inputs = [self._first_link, *self._loads, data.xmat]
            shape = self._loads[0].shape[:2]
            wp.launch(kernels.apply_loads, dim=shape, inputs=inputs, outputs=[data.xfrc_applied])
        row = [data.nefc, efc.type, efc.id]
        inputs = [*row, efc.vel, data.ten_length, self._rest, self._compliance]
        inputs += [self._keep, self._step]
        outputs = [efc.aref, efc.D]
        shape = (self.num, self._rows)
        wp.launch(kernels.aim_cables, dim=shape, inputs=inputs, outputs=outputs)
        mjw.step2(self.model, data)
        inputs = [*row, efc.force, self._fastest, self._start, self._step]
        outputs = [data.qpos, data.qvel, data.qacc_warmstart, self.tension, self.time]
        outputs += [self.diverged, self.culprit, self.speed]
        wp.launch(kernels.end_step, dim=self.num, inputs=inputs, outputs=outputs)
        if restart:
            self._restart()
        else:
            self._update()

    def _update(self) -> None:
        data, host = self.data, self.host
        mjw.step1(self.model, data)
        link, base = int(host.site_bodyid[self._tip]), host.body("base").id
        inputs = [self._tip, link, base, data.site_xpos, data.subtree_com, data.cvel]
        outputs = [self.tip, self.tip_velocity, self.base_turning]
        wp.launch(kernels.measure, dim=self.num, inputs=inputs, outputs=outputs)

    def _restart(self) -> None:
        data = self.data
        outputs = [data.qpos, data.qvel, data.qacc_warmstart, self.tension, self.time]
        inputs = [self.chosen, *(self._own_start or (self._start, self._still))]
        outputs += [self.diverged]
        wp.launch(kernels.restart, dim=self.num, inputs=inputs, outputs=outputs)
        self._update()

    def set_loads(self, loads: Loads) -> None:
        """Let loads act from the next step on."""
        self._graphs = {name: g for name, g in self._graphs.items() if "step" not in name}
        self.data.xfrc_applied.zero_()
        arrays = (loads.force, loads.torque, loads.point) if loads.active else ()
        self._loads = [wp.array(each, dtype=wp.vec3) for each in arrays]

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give copies `ids` the numbers in the rows of `plant`; `forward` must follow."""
        start, rest = self._start.numpy(), self._rest.numpy()
        start[ids, self._sliders] = plant.start_travel
        rest[ids] = self._described[ids] + plant.rest_length_offset
        self._start.assign(start)
        self._rest.assign(rest)
        compliance = self._compliance.numpy()
        compliance[ids] = plant.cable_compliance
        self._compliance.assign(compliance)
        moved = False
        for name, rows in plant_fields(self.host, plant).items():
            own = self._own(name)
            numbers = own.numpy()
            moved |= name in MASSES and bool((numbers[ids] != np.float32(rows)).any())
            numbers[ids] = rows
            own.assign(numbers)
        if moved:
            self._derive()

    def _own(self, name: str) -> Warp:
        """Return an array of the model that has a row for every copy."""
        array = getattr(self.model, name)
        if len(array) != self.num:
            self._graphs.clear()  # they hold the array that all copies share
            array = wp.array(np.repeat(array.numpy(), self.num, axis=0), dtype=array.dtype)
            setattr(self.model, name, array)
        return array

    def _derive(self) -> None:
        """Bring the numbers that follow from masses up to date.

        Copies as described get those that MuJoCo has found in double precision.
        """
        described = np.ones(self.num, dtype=bool)
        for name in MASSES:
            found = self._own(name).numpy().reshape(self.num, -1)
            described &= (found == np.float32(getattr(self.host, name)).ravel()).all(axis=1)
        own = [self._own(name) for name in _DERIVED]
        mjw.set_const(self.model, self.data, restore=False)
        for name, array in zip(_DERIVED, own, strict=True):
            numbers = array.numpy()
            numbers[described] = getattr(self.host, name)
            array.assign(numbers)


def _spec(robot: Robot) -> mujoco.MjSpec:
    """Build the model: that of the engine `mujoco`, without what only it reads."""
    spec = stepping_spec(robot)
    option = spec.option
    option.solver, option.iterations = mujoco.mjtSolver.mjSOL_NEWTON, _ITERATIONS
    option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # Warp never resets
    held = [e for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_TENDON]
    for part in (*held, *spec.sensors, *spec.geoms, *spec.lights):
        spec.delete(part)
    for tendon in spec.tendons:
        tendon.limited, tendon.range = mujoco.mjtLimited.mjLIMITED_TRUE, _ALWAYS
        tendon.solref_limit, tendon.solimp_limit = rigid_solref(robot), RIGID_SOLIMP
    return spec


def _floats(numbers: Array) -> Warp:
    """Return an array on the current device, in single precision."""
    return wp.array(numbers, dtype=wp.float32)
