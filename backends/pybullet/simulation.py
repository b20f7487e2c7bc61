"""The PyBullet engines: Bullet moves the robot, and this package adds cables and servos.

Bullet's articulated-body step integrates base, sliders and links, with its own joint damping and
hinge limits. Cables, springs and servos act as joint torques; see :mod:`backends.pybullet.cables`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from importlib.metadata import version as package_version
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.client import MAX_JOINT_SPEED
from backends.pybullet.equation import Equation
from backends.pybullet.options import PybulletOptions, PybulletStockOptions
from backends.pybullet.workers import Pool
from backends.pybullet.world import World
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import (
    Array,
    Capability,
    Dynamics,
    EngineOptions,
    Physics,
    Simulation,
    Snapshot,
    State,
)
from cdcsr.simulation.engines import processors
from cdcsr.simulation.plant import Plant

if TYPE_CHECKING:
    from backends.viewers.software import Renderer

COPIES_PER_WORKER = 8
POOL_FROM = 16
"""Worker processes are faster for this many copies or more."""


class PybulletSimulation(Simulation):
    """`num` copies of a robot in PyBullet.

    Args:
        robot: the description.
        num: how many copies.
        options: :class:`backends.pybullet.options.PybulletOptions`.
        workers: how many worker processes share the copies; with 0 they are stepped in this
            process. By default there are workers for 16 copies or more, if there is more than one
            processor. The numbers do not depend on it.

    When :class:`Diverged` is raised, the copy that diverged is back at the start, and the others
    have made the step.
    """

    engine: ClassVar[str] = "pybullet"
    title: ClassVar[str] = "PyBullet"
    capabilities: ClassVar[frozenset[Capability]] = frozenset(
        {"render", "elastic_cables", "servo_kinds", "guide_friction"}
    )
    copy_memory = 4e6
    options_type: ClassVar[type[EngineOptions]] = PybulletOptions
    version: ClassVar[str] = package_version("pybullet")
    physics: ClassVar[Physics] = Physics(
        joint_dynamics="Bullet's articulated-body step",
        integration="Bullet's, semi-implicit",
        cables="ours: tensions solved for in each step with Bullet's mass matrix, as joint torques",
        limits="Bullet's",
        servos="ours: forces on the sliders, by the option servo",
        damping="Bullet's joint damping; none of bodies, by the option damping",
    )

    def __init__(
        self,
        robot: Robot,
        num: int = 1,
        options: EngineOptions | None = None,
        *,
        workers: int | None = None,
    ) -> None:
        super().__init__(robot, num, options)
        assert isinstance(self.options, PybulletOptions)
        self._options = self.options
        if workers is None:
            workers = min(processors(), -(-num // COPIES_PER_WORKER)) if num >= POOL_FROM else 0
            workers = workers if workers > 1 else 0
        if not 0 <= workers <= num:
            raise CdcsrError(
                f"{num} copies can be shared by 0 to {num} worker processes, not {workers}."
            )
        world = Pool(robot, num, self.options, workers) if workers else None
        self._world = world or World(robot, num, self.options)

    @classmethod
    def check_robot(cls, robot: Robot, plant: Plant, options: EngineOptions) -> None:
        super().check_robot(robot, plant, options)
        assert isinstance(options, PybulletOptions)
        plain = all(s.kind == "set-point" and not s.pretension for s in robot.servos)
        if options.servo == "motor" and not plain:
            raise CdcsrError(
                f"Bullet's position motors are set-point servos without pretension, and those of "
                f"{robot.name!r} are not; write {cls.engine}:servo=force."
            )

    @property
    def ideal(self) -> bool:
        return self._options.damping == 0

    def _set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        self._world.set_plant(ids, plant)

    def _set_loads(self) -> None:
        self._world.set_loads(self.loads)

    def _reset(self, ids: NDArray[np.int64]) -> None:
        self._world.reset(ids.tolist())

    def _place(self, ids: NDArray[np.int64], position: Array, velocity: Array) -> None:
        pulls = np.zeros((len(ids), self._world.pulls.shape[1]))
        self._world.place(ids, np.zeros(len(ids)), position, velocity, pulls)

    def _step(self, command: Array, substeps: int) -> None:
        lost = self._world.step(command, substeps)
        if lost:
            copies = [divergence.copy for divergence in lost]
            self._stop_commands(np.array(copies))
            raise self._diverged(copies, lost[0].time, lost[0].what)

    def _state(self) -> State:
        world, joints, tip = self._world, 7 + self.robot.num_cables, self._world.tip
        return State(
            time=world.time.copy(),
            tip_position=tip[:, :3].copy(),
            tip_velocity=tip[:, 3:].copy(),
            base_position=world.position[:, :3].copy(),
            base_quaternion=world.position[:, 3:7].copy(),
            base_velocity=world.velocity[:, :3].copy(),
            base_angular_velocity=world.velocity[:, 3:6].copy(),
            cable_travel=world.position[:, 7:joints].copy(),
            cable_tension=world.pulls[:, : self.robot.num_cables].copy(),
            joint_angles=world.position[:, joints:].copy(),
            joint_rates=world.velocity[:, joints - 1 :].copy(),
        )

    def _get_snapshot(self) -> Snapshot:
        world = self._world
        return Snapshot(
            engine=self.engine,
            robot=self.robot.fingerprint,
            time=world.time.copy(),
            position=world.position.copy(),
            velocity=world.velocity.copy(),
            private=world.pulls.copy(),
        )

    def _set_snapshot(self, snapshot: Snapshot) -> None:
        own = snapshot.engine == self.engine
        pulls, every = np.zeros(self._world.pulls.shape), np.arange(self.num)
        if own:
            width = snapshot.private.shape[1]
            if width not in (
                self.robot.num_cables,
                pulls.shape[1],
            ):  # older ones have tensions only
                raise ValueError(f"its private part has {width} numbers for each copy")
            pulls[:, : snapshot.private.shape[1]] = snapshot.private
        self._world.place(every, snapshot.time, snapshot.position, snapshot.velocity, pulls)

    def _dynamics(self, ids: NDArray[np.int64]) -> Dynamics:
        plant = Plant(*(rows[ids] for rows in self.plant))
        position, velocity = self._world.position[ids], self._world.velocity[ids]
        load = self.loads.generalized(position, ids) if self.loads.active else None
        return self._equation.dynamics(position, velocity, plant, load)

    def _render(self, index: int, camera: str, targets: Array) -> NDArray[np.uint8]:
        return self._renderer.draw(self._world.position[index], camera, targets)

    def _close(self) -> None:
        self._world.close()
        for name in ("_equation", "_renderer"):
            if name in self.__dict__:
                self.__dict__[name].close()

    @cached_property
    def _equation(self) -> Equation:
        return Equation(self.robot)

    @cached_property
    def _renderer(self) -> Renderer:
        from backends.viewers.software import Renderer  # an import of half a second

        return Renderer(self.robot)


class PybulletStock(PybulletSimulation):
    """The same with what Bullet does by default: it damps all bodies, clamps joint speeds, and its
    position motors are the servos."""

    engine: ClassVar[str] = "pybullet-stock"
    title: ClassVar[str] = "PyBullet, stock"
    variant_of: ClassVar[str | None] = "pybullet"
    physics: ClassVar[Physics] = replace(
        PybulletSimulation.physics,
        servos="Bullet's position motors, by the option servo",
        damping="Bullet's joint damping, and Bullet's damping of all bodies",
    )
    options_type: ClassVar[type[EngineOptions]] = PybulletStockOptions
    switches: ClassVar[Mapping[str, str]] = {
        "damping": "0",
        "max_joint_speed": f"{MAX_JOINT_SPEED:g}",
        "servo": "force",
    }
