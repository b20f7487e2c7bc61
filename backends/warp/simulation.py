"""The engine `warp`: copies on a GPU, for which NumPy arrays come and go, or torch tensors stay."""

from __future__ import annotations

from typing import Any

import mujoco_warp
import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from pydantic import Field

from backends.mujoco.active_cables import base_size
from backends.mujoco.simulation import MujocoSimulation
from backends.warp.device import Copies, choose_device
from backends.warp.device_steps import DeviceSteps
from backends.warp.equation import equation_of_motion
from backends.warp.tensors import tensors_of
from cdcsr.robot.description import Robot
from cdcsr.robot.stability import highest_speeds, too_fast
from cdcsr.simulation.contract import (
    Array,
    Dynamics,
    EngineOptions,
    Physics,
    Snapshot,
    State,
)
from cdcsr.simulation.plant import Plant
from cdcsr.simulation.rotations import rotation_matrix
from cdcsr.simulation.turns import taking_turns


class WarpOptions(EngineOptions):
    """The options of `warp`."""

    device: str = Field("auto", pattern=r"^(auto|cpu|cuda(:\d+)?)$")
    """Where the copies are: cuda, cuda:1 for another GPU, cpu; auto takes a GPU if there is one."""

    @property
    def free_memory(self) -> float | None:
        device = choose_device(self.device)
        return float(device.free_memory) if device.is_cuda else None


@taking_turns
class WarpSimulation(DeviceSteps):
    """`num` copies of a robot in MuJoCo Warp, in single precision.

    :meth:`device_state`, :meth:`step_device` and :meth:`reset_device` are for those who stay on the
    device; they copy nothing to the host and do not wait for the device.

    Raises:
        CdcsrError: there is no such device.
    """

    engine = "warp"
    title = "MuJoCo Warp"
    version = mujoco_warp.__version__
    capabilities = frozenset({"render", "single_precision", "elastic_cables", "servo_kinds"})
    options_type = WarpOptions
    physics = Physics(
        joint_dynamics="MuJoCo Warp's",
        integration="MuJoCo Warp's Euler, semi-implicit",
        cables="ours: limits of tendons that are aimed at the rest length in each step",
        limits="MuJoCo Warp's, with the softness of the description",
        servos="MuJoCo Warp's position actuators",
        damping="ours: MuJoCo Warp's, made implicit in the mass matrix of each step",
    )
    copy_memory = 0.1e6

    def __init__(self, robot: Robot, num: int = 1, options: EngineOptions | None = None) -> None:
        super().__init__(robot, num, options)
        assert isinstance(self.options, WarpOptions)
        self._copies = Copies(robot, num, choose_device(self.options.device))
        self._q, self._v = base_size(robot)
        self._drawer: MujocoSimulation | None = None
        self._tensors = tensors_of(self._copies, robot)
        self._command = wp.to_torch(self._copies.data.ctrl)
        self._chosen_copies = wp.to_torch(self._copies.chosen)
        self._plants: list[tuple[torch.Tensor, torch.Tensor]] = []
        every = np.arange(num)
        if self.plant.cable_compliance.any():
            self._set_plant(every, self.plant)
        self._reset(every)

    def _set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        with self._copies.active():
            self._copies.set_plant(ids, plant)
            self._copies.forward()

    def _set_loads(self) -> None:
        with self._copies.active():
            self._copies.set_loads(self.loads)

    def _reset(self, ids: NDArray[np.int64]) -> None:
        mask = np.zeros(self.num, dtype=bool)
        mask[ids] = True
        with self._copies.active():
            self._copies.chosen.assign(mask)
            self._copies.restart()

    def _place(self, ids: NDArray[np.int64], position: Array, velocity: Array) -> None:
        own = velocity[:, 6 - self._v :].copy()
        if self._v:
            to_body = rotation_matrix(position[:, 3:7]).swapaxes(1, 2)
            own[:, 3:6] = np.einsum("nij,nj->ni", to_body, velocity[:, 3:6])
        parts = (position[:, 7 - self._q :], own, 0.0, 0.0, 0.0)
        with self._copies.active():
            self._write(ids, parts)
            self._copies.forward()

    def _write(self, ids: NDArray[np.int64], parts: tuple[Array | float, ...]) -> None:
        """Write position, velocity, the solver's first guess, tension and time of copies `ids`."""
        copies = self._copies
        data = copies.data
        arrays = data.qpos, data.qvel, data.qacc_warmstart, copies.tension, copies.time
        for array, rows in zip((*arrays, copies.diverged), (*parts, False), strict=True):
            numbers = array.numpy()
            numbers[ids] = rows
            array.assign(numbers)

    def _step(self, command: Array, substeps: int) -> None:
        copies = self._copies
        with copies.active():
            copies.data.ctrl.assign(command.astype(np.float32))
            for _ in range(substeps):
                copies.step()
            lost = np.flatnonzero(copies.diverged.numpy()).tolist()
            if lost:
                first, velocity = lost[0], np.zeros(self.robot.num_coordinates)
                culprit = 6 - self._v + int(copies.culprit.numpy()[first])
                velocity[culprit] = copies.speed.numpy()[first]
                time = float(copies.time.numpy()[first])
                what = too_fast(velocity, highest_speeds(self.robot))
                raise self._diverged(lost, time, what)

    def _state(self) -> State:
        cables, copies = self.robot.num_cables, self._copies
        with copies.active():
            qpos, qvel = self._whole_position(), self._whole_velocity()
            return State(
                time=_doubles(copies.time),
                tip_position=_doubles(copies.tip),
                tip_velocity=_doubles(copies.tip_velocity),
                base_position=qpos[:, 0:3],
                base_quaternion=qpos[:, 3:7],
                base_velocity=qvel[:, 0:3],
                base_angular_velocity=qvel[:, 3:6],
                cable_travel=qpos[:, 7 : 7 + cables],
                cable_tension=_doubles(copies.tension),
                joint_angles=qpos[:, 7 + cables :],
                joint_rates=qvel[:, 6 + cables :],
            )

    def _whole_position(self) -> Array:
        """Return the positions of all copies with those of the base, shape (num, 7 + C + H)."""
        qpos = _doubles(self._copies.data.qpos)
        if self._q:
            qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
            return qpos
        base = self.robot.base
        fixed = np.tile([*base.position, *base.quaternion], (self.num, 1))
        return np.concatenate([fixed, qpos], axis=1)

    def _whole_velocity(self) -> Array:
        """Return the velocities of all copies in the contract's order, shape (num, nv)."""
        qvel = _doubles(self._copies.data.qvel)
        if not self._v:
            return np.concatenate([np.zeros((self.num, 6)), qvel], axis=1)
        qvel[:, 3:6] = _doubles(self._copies.base_turning)
        return qvel

    def _get_snapshot(self) -> Snapshot:
        copies = self._copies
        data = copies.data
        with copies.active():
            parts = data.qpos, data.qvel, data.qacc_warmstart, copies.tension
            return Snapshot(
                self.engine,
                self.robot.fingerprint,
                _doubles(copies.time),
                self._whole_position(),
                self._whole_velocity(),
                np.concatenate([_doubles(part) for part in parts], axis=1),
            )

    def _set_snapshot(self, snapshot: Snapshot) -> None:
        every = np.arange(self.num)
        if snapshot.engine != self.engine:
            self._place(every, snapshot.position, snapshot.velocity)
            with self._copies.active():
                self._copies.time.assign(snapshot.time)
            return
        nq, nv = self._copies.host.nq, self._copies.host.nv
        qpos, qvel, guess, tension = np.split(snapshot.private, [nq, nq + nv, nq + 2 * nv], axis=1)
        with self._copies.active():
            self._write(every, (qpos, qvel, guess, tension, snapshot.time))
            self._copies.forward()

    def _dynamics(self, ids: NDArray[np.int64]) -> Dynamics:
        with self._copies.active():
            position = self._whole_position()[ids]
            found = equation_of_motion(self._copies, self.robot, ids, position[:, 3:7])
        if self.loads.active:
            found.passive_force[:] += self.loads.generalized(position, ids)
        return found

    def _render(self, index: int, camera: str, targets: Array) -> NDArray[np.uint8]:
        """Draw with MuJoCo."""
        if self._drawer is None:
            self._drawer = MujocoSimulation(self.robot)
        with self._copies.active():
            position, velocity = self._whole_position(), self._whole_velocity()
        self._drawer.place(None, position[[index]], velocity[[index]])
        return self._drawer.render(0, camera, targets[0] if len(targets) else None)

    def _close(self) -> None:
        if self._drawer is not None:
            self._drawer.close()


def _doubles(array: Any) -> Array:  # Warp has no types
    """Return an array of Warp's as one of NumPy's, in double precision."""
    return np.array(array.numpy(), dtype=np.float64)
