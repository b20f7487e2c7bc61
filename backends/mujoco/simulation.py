"""Copies of a robot in a `mujoco.batch`, stepped by a pool of threads, and the engine `mujoco`."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from backends.mujoco.active_cables import CURRENT, Cables, Limits, base_size, stepping_spec
from backends.mujoco.copies import (
    dense_tendon_jacobian,
    load_force,
    turn_base,
    write_plant,
)
from cdcsr.errors import CdcsrError
from cdcsr.robot.colors import TARGET, TARGET_RADIUS
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.robot.stability import highest_speeds, too_fast
from cdcsr.simulation.cameras import HEIGHT, WIDTH, camera_angles
from cdcsr.simulation.capstan import Capstan
from cdcsr.simulation.contract import (
    Array,
    Dynamics,
    EngineOptions,
    Physics,
    Simulation,
    Snapshot,
    State,
)
from cdcsr.simulation.engines import processors
from cdcsr.simulation.plant import Plant
from cdcsr.simulation.rotations import rotation_matrix

_WHOLE_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
"""The parts of the state that a row of `batch.state` holds."""


_no_opengl: list[str] = []
"""The names of the errors with which OpenGL failed to start in this process. A second attempt would
end the process."""


def _make_renderer(model: mujoco.MjModel) -> mujoco.Renderer:
    """Start OpenGL.

    Raises:
        CdcsrError: it does not start, or failed to before.
    """
    if not _no_opengl:
        try:
            model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
            return mujoco.Renderer(model, HEIGHT, WIDTH)
        except Exception as error:  # every GL platform raises another type
            _no_opengl.append(type(error).__name__)
    raise CdcsrError(
        "MuJoCo cannot draw here: it found no OpenGL (set MUJOCO_GL to egl, osmesa or glfw before "
        f"the start, or draw with the pybullet engine, which needs none). [{_no_opengl[0]}]"
    )


class BatchSimulation(Simulation):
    """`num` copies of a robot in MuJoCo; an engine says which model they step, and what holds the
    cables.

    Args:
        robot: the description.
        num: how many copies.
        options: how the engine steps; None for its defaults.
        threads: how many threads step the copies. By default one for fewer than 8 copies, else one
            for each processor. The numbers do not depend on it.
    """

    version = mujoco.__version__
    cables_type: ClassVar[type[Cables | Limits]]
    """The class that holds the cables of a batch."""
    copy_memory = 0.25e6

    def __init__(
        self,
        robot: Robot,
        num: int = 1,
        options: EngineOptions | None = None,
        *,
        threads: int | None = None,
    ) -> None:
        super().__init__(robot, num, options)
        if threads is None:  # to wake a thread costs about as much as to step a few copies
            threads = processors() if num >= 8 else 1
        self._threads = threads
        self._build()
        self.reset()

    def _build(self) -> None:
        """Make the batch, for cables that rub only if some do: this takes twice as long."""
        robot = self.robot
        self._rubs = bool(self.plant.guide_friction.any())
        self.model = model = self._spec().compile()
        self.batch = batch.Batch(model, self.num, self._threads, True)
        self._sensors = self.batch.bind("sensordata")
        self._qpos, self._qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._time, self._ctrl = self.batch.bind("time"), self.batch.bind("ctrl")
        self._cables = self.cables_type(robot, self.batch)
        self._q, self._v = base_size(self.robot)
        self._start = np.array(robot.start_angles)
        self._fastest = highest_speeds(robot)[6 - self._v :]
        first_link = model.body("link_0").id
        self._frames = self.batch.bind("xmat").reshape(self.num, -1, 3, 3)[:, first_link:]
        self._wrenches = self.batch.bind("xfrc_applied")[:, first_link:]
        self._scratch = mujoco.MjData(model)
        self._renderer: mujoco.Renderer | None = None
        # Receives the model of a copy that is looked at; None while all copies have the same model.
        self._own_model: mujoco.MjModel | None = None

    @abstractmethod
    def _spec(self) -> mujoco.MjSpec:
        """Build the model that all copies step, by `robot` and `options`."""

    def _set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        if plant.guide_friction.any() and not self._rubs:
            snapshot = self._get_snapshot()
            self._build()
            self._set_plant(np.arange(self.num), self.plant)
            self._set_snapshot(snapshot)
            return
        write_plant(self.batch, ids, plant)
        self._cables.set_plant(ids, plant)
        # The next step starts from what the last one has computed, which is out of date now.
        self.batch.forward(ids, stage=CURRENT)
        if self._own_model is None:
            self._own_model = self.batch.get_model(0)

    def _reset(self, ids: NDArray[np.int64]) -> None:
        self._forget(ids)
        self.batch.reset(ids, stage=CURRENT)
        travel = self.plant.start_travel[ids]
        if travel.any() or self._start.any():
            self._qpos[ids, self._q : self._q + self.robot.num_cables] = travel
            self._qpos[ids, self._q + self.robot.num_cables :] = self._start
            self.batch.forward(ids, stage=CURRENT)

    def _forget(self, ids: NDArray[np.int64]) -> None:
        """Take away what copies keep of their last step."""
        self._cables.tension[ids] = 0
        if self._cables.friction is not None:
            self._cables.friction.bound[ids] = 0

    def _place(self, ids: NDArray[np.int64], position: Array, velocity: Array) -> None:
        self.batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._qpos[ids] = position[:, 7 - self._q :]
        self._qvel[ids] = velocity[:, 6 - self._v :]
        if self._v:
            to_body = rotation_matrix(position[:, 3:7]).swapaxes(1, 2)
            self._qvel[ids, 3:6] = np.einsum("nij,nj->ni", to_body, velocity[:, 3:6])
        self._forget(ids)
        self.batch.forward(ids, stage=CURRENT)

    def _step(self, command: Array, substeps: int) -> None:
        self._ctrl[:] = command
        for _ in range(substeps):
            if self.loads.active:
                self._set_loads()
            self._cables.step()
        self._check_divergence()

    def _set_loads(self) -> None:
        self._wrenches[..., :3], self._wrenches[..., 3:] = self.loads.at_centers(self._frames)

    def _check_divergence(self) -> None:
        # NaN compares false, so "not below" catches it too.
        right = np.abs(self._qvel) < self._fastest
        if not right.all():
            copies = np.flatnonzero(~right.all(axis=1)).tolist()
            what = too_fast(self._whole_velocity()[copies[0]], highest_speeds(self.robot))
            raise self._diverged(copies, float(self._time[copies[0]]), what)

    def _state(self) -> State:
        num_cables = self._ctrl.shape[1]
        sensors = self._sensors.copy()
        qpos, qvel = self._whole_position(), self._whole_velocity()
        return State(
            time=self._time.copy(),
            tip_position=sensors[:, 0:3],
            tip_velocity=sensors[:, 3:6],
            base_position=qpos[:, 0:3],
            base_quaternion=qpos[:, 3:7],
            base_velocity=qvel[:, 0:3],
            base_angular_velocity=sensors[:, 6:9],
            cable_travel=qpos[:, 7 : 7 + num_cables],
            cable_tension=self._cables.tension.copy(),
            joint_angles=qpos[:, 7 + num_cables :],
            joint_rates=qvel[:, 6 + num_cables :],
        )

    def _get_snapshot(self) -> Snapshot:
        velocity = self._whole_velocity()
        velocity[:, 3:6] = self._sensors[:, 6:9]  # MuJoCo's own is in the base frame
        parts = [self.batch.state, self._cables.tension]
        if self._cables.friction is not None:
            parts.append(self._cables.friction.bound)
        return Snapshot(
            self.engine,
            self.robot.fingerprint,
            self._time.copy(),
            self._whole_position(),
            velocity,
            np.concatenate(parts, axis=1),
        )

    def _set_snapshot(self, snapshot: Snapshot) -> None:
        if snapshot.engine == self.engine:
            size = self.batch.state.shape[1]
            self.batch.state[:] = snapshot.private[:, :size]
            bounds = size + self.robot.num_cables
            self._cables.tension[:] = snapshot.private[:, size:bounds]
            rest = snapshot.private[:, bounds:]
            if rest.shape[1] not in (0, len(Capstan(self.robot).cable)):
                raise ValueError(f"its private part has {rest.shape[1]} numbers too many")
            if self._cables.friction is not None:
                self._cables.friction.bound[:] = rest if rest.size else 0
        else:
            self._place(np.arange(self.num), snapshot.position, snapshot.velocity)
            self._time[:] = snapshot.time
        self.batch.forward(stage=CURRENT)

    def _whole_position(self) -> Array:
        """Return the positions of all copies with those of the base, shape (num, 7 + C + H)."""
        if self._q:
            return self._qpos.copy()
        base = self.robot.base
        fixed = np.tile([*base.position, *base.quaternion], (self.num, 1))
        return np.concatenate([fixed, self._qpos], axis=1)

    def _whole_velocity(self) -> Array:
        """Return the velocities of all copies with those of the base, shape (num, nv)."""
        if self._v:
            return self._qvel.copy()
        return np.concatenate([np.zeros((self.num, 6)), self._qvel], axis=1)

    def write_to(self, data: mujoco.MjData, index: int = 0) -> None:
        """Write the state of one copy into MuJoCo data with the same coordinates.

        The caller must call `mj_forward` to update what follows from the state.
        """
        mujoco.mj_setState(data.model, data, self.batch.state[index], _WHOLE_STATE)

    def read_from(self, data: mujoco.MjData, index: int = 0) -> None:
        """Continue one copy from the state in MuJoCo data with the same coordinates, applied forces
        included."""
        mujoco.mj_getState(data.model, data, self.batch.state[index], _WHOLE_STATE)
        self.batch.forward([index], stage=CURRENT)

    def _dynamics(self, ids: NDArray[np.int64]) -> Dynamics:
        model, data, own = self.model, self._scratch, self._own_model
        nv, num_cables = self.robot.num_coordinates, self.robot.num_cables
        mass, tip = np.zeros((len(ids), nv, nv)), np.zeros((len(ids), 3, nv))
        bias, passive, velocity = np.zeros((3, len(ids), nv))
        cables = np.zeros((len(ids), num_cables, nv))
        length = np.zeros((len(ids), num_cables))
        own_mass, own_tip = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
        tip_site, diagonal = model.site("tip").id, np.arange(model.nv)
        moved = slice(6 - self._v, None)  # all but a fixed base
        mass[:, :6, :6] = np.eye(6)
        for i, copy in enumerate(ids):
            if own is not None:
                model = self.batch.get_model(int(copy), own)
            data.qpos, data.qvel = self._qpos[copy], self._qvel[copy]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fullM(model, data, own_mass)
            own_mass[diagonal, diagonal] -= model.dof_armature  # no mass: see stepping_spec
            mass[i, moved, moved] = own_mass
            mujoco.mj_jacSite(model, data, own_tip, None, tip_site)
            tip[i, :, moved] = own_tip
            bias[i, moved], passive[i, moved] = data.qfrc_bias, data.qfrc_passive
            velocity[i, moved] = data.qvel
            rows = dense_tendon_jacobian(model, data)[:num_cables]
            cables[i, :, moved], length[i] = rows, data.ten_length[:num_cables]
            if self.loads.active:
                passive[i, moved] += load_force(model, data, self.loads, int(copy))
        found = Dynamics(mass, bias, passive, tip, cables, velocity, length)
        return turn_base(found, self._qpos[ids, 3:7]) if self._v else found

    def _render(self, index: int, camera: str, targets: Array) -> NDArray[np.uint8]:
        azimuth, elevation = camera_angles(camera)
        renderer = self._renderer
        if renderer is None:
            renderer = self._renderer = _make_renderer(self.model)
        view = mujoco.MjvCamera()
        view.lookat[:] = self.model.stat.center
        view.distance, view.azimuth = 1.9 * self.model.stat.extent, azimuth + 90
        view.elevation = elevation
        self._scratch.qpos = self._qpos[index]
        mujoco.mj_forward(self.model, self._scratch)
        renderer.update_scene(self._scratch, view)
        for target in targets:
            self._mark(renderer.scene, target)
        return renderer.render()

    def _mark(self, scene: mujoco.MjvScene, target: Array) -> None:
        """Add a ball to a scene, as large as the other renderer draws it."""
        scene.ngeom += 1
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom - 1],
            mujoco.mjtGeom.mjGEOM_SPHERE,
            np.full(3, ruler(self.robot).size * TARGET_RADIUS),
            target,
            np.eye(3).ravel(),
            np.array(TARGET, np.float32) / np.float32(255),
        )

    def _close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class MujocoSimulation(BatchSimulation):
    """`num` copies of a robot in MuJoCo, with cables that do not stretch; see
    :mod:`backends.mujoco.active_cables`."""

    engine = "mujoco"
    title = "MuJoCo"
    capabilities = frozenset(
        {"render", "bit_exact", "elastic_cables", "servo_kinds", "guide_friction"}
    )
    physics = Physics(
        joint_dynamics="MuJoCo's",
        integration="MuJoCo's Euler, semi-implicit",
        cables="ours: MuJoCo's equalities, switched in each step by an active-set method",
        limits="MuJoCo's, with the softness of the description",
        servos="MuJoCo's position actuators",
        damping="ours: MuJoCo's, made implicit in the mass matrix of each step",
    )
    cables_type = Cables

    def _spec(self) -> mujoco.MjSpec:
        return stepping_spec(self.robot, friction=self._rubs)
