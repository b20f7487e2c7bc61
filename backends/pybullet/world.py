"""Copies of a robot that are stepped together in this process."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from backends.pybullet.body import Body
from backends.pybullet.cables import joint_forces
from backends.pybullet.client import connect
from backends.pybullet.equation import Equation
from backends.pybullet.options import PybulletOptions
from backends.pybullet.rig import of_copy, packed, rig
from cdcsr.compiled import compiled
from cdcsr.robot.description import Robot
from cdcsr.robot.stability import highest_speeds, too_fast
from cdcsr.simulation.capstan import Capstan
from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Parameters, Plant
from cdcsr.simulation.rotations import rotation_matrix

Array = NDArray[np.float64]

COPIES_PER_CLIENT = 4
"""The time of PyBullet's step grows with the square of the bodies in a client, and a client takes
27 MB."""


class Divergence(NamedTuple):
    """A copy that has diverged."""

    copy: int
    time: float
    """The simulated time of the copy, in [s]."""
    what: str
    """The cause, for the message."""


class World:
    """`num` copies of a robot, with all hinges at their rest angles at the start.

    Attributes:
        time: shape (num,), in [s].
        position: as in a Snapshot, shape (num, 7 + C + H).
        velocity: shape (num, nv).
        pulls: of the last step of Bullet, in [N]: the cables' tensions, then the friction of each
            place of :class:`Capstan`, zero where nothing rubs; shape (num, C + R).
    """

    def __init__(self, robot: Robot, num: int, options: PybulletOptions) -> None:
        self._options = options
        self._clients: list[int] = []
        self._disconnect = weakref.finalize(self, _disconnect, self._clients)
        self._bodies: list[Body] = []
        # Bullet solves all contacts of a client together, and so copies would not be independent.
        together = 1 if options.contact else COPIES_PER_CLIENT
        for copy in range(num):
            if copy % together == 0:
                self._clients.append(connect(robot, options.substeps))
            self._bodies.append(Body(robot, self._clients[-1], options))
        self._equation = Equation(robot)
        self._plant = Parameters().plant(robot, num)
        self._asked = self._equation.bodies(self._plant)
        self._rig, self._time_step = rig(robot), robot.time_step
        self._step, self._motors = robot.time_step / options.substeps, options.servo == "motor"
        self._numbers = [packed(self._rig)] * num
        self._loads = Loads(robot, num)
        self.time = np.zeros(num)
        self.position = np.zeros((num, 7 + robot.num_cables + robot.num_hinges))
        self.velocity = np.zeros((num, robot.num_coordinates))
        self._capstan, self._rubs = Capstan(robot), bool(self._plant.guide_friction.any())
        self._tails, self._bound = np.zeros((0, robot.num_hinges)), np.zeros(0)
        self.pulls = np.zeros((num, robot.num_cables + len(self._capstan.cable)))
        self._tension, self._friction = np.split(self.pulls, [robot.num_cables], axis=1)
        self._rates = self.velocity[:, 6:]
        self._force = np.zeros(robot.num_cables + robot.num_hinges)
        self._servo = np.zeros(robot.num_cables)
        self._fastest = highest_speeds(robot)
        # A joint that Bullet clamps would be faster.
        np.minimum(self._fastest[6:], 0.999 * options.max_joint_speed, out=self._fastest[6:])
        self._fixed = robot.base.mount == "fixed"
        self._start = np.array([*robot.base.position, *robot.base.quaternion])
        self.reset(range(num))

    @property
    def tip(self) -> Array:
        """Position and velocity of the tip, shape (num, 6), in [m] and [m/s]."""
        return np.array([body.tip() for body in self._bodies])

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give copies `ids` the numbers in the rows of `plant`."""
        for mine, new in zip(self._plant, plant, strict=True):
            mine[ids] = new
        for row, copy in enumerate(ids.tolist()):
            self._bodies[copy].set_plant(plant, row)
            self._numbers[copy] = packed(of_copy(self._rig, plant, row))
        self._asked = self._equation.bodies(self._plant)
        self._rubs = bool(self._plant.guide_friction.any())
        if not self._rubs:
            self._tails, self._bound = self._tails[:0], self._bound[:0]
            self._friction[:] = 0.0

    def set_loads(self, loads: Loads) -> None:
        """Let loads act on all copies from the next step on."""
        self._loads = loads

    def reset(self, ids: Iterable[int]) -> None:
        """Put copies back to the start."""
        travel = self._plant.start_travel
        for copy in ids:
            self.time[copy] = 0.0
            self.position[copy] = 0.0
            self.position[copy, :7] = self._start
            self.position[copy, 7:] = *travel[copy], *self._rig.rest
            self.velocity[copy] = 0.0
            self.pulls[copy] = 0.0
            self._write(copy)

    def place(
        self,
        ids: NDArray[np.int64],
        time: Array,
        position: Array,
        velocity: Array,
        pulls: Array,
    ) -> None:
        """Put copies `ids` into a state: rows of the attributes."""
        self.time[ids], self.pulls[ids] = time, pulls
        self.position[ids], self.velocity[ids] = position, velocity
        if self._fixed:
            self.position[ids, :7], self.velocity[ids, :6] = self._start, 0.0
        for copy in ids.tolist():
            self._write(copy)

    def step(self, command: Array, substeps: int) -> list[Divergence]:
        """Advance all copies.

        Args:
            command: servo set-points, shape (num, C), in [m].
            substeps: how many time steps.

        Returns:
            The copies that diverged, in order. They are back at the start; the others have made all
            substeps.
        """
        lost: dict[int, Divergence] = {}
        for _ in range(substeps):
            for _ in range(self._options.substeps):
                for copy in range(len(self._bodies)):
                    self._push(copy, command[copy])
                for client in self._clients:
                    pybullet.stepSimulation(physicsClientId=client)
                for body, place, speed in zip(
                    self._bodies, self.position, self.velocity, strict=True
                ):
                    body.read(place, speed)
            if not _advance(self.time, self._time_step, self.velocity, self._fastest):
                for copy in np.flatnonzero(
                    ~(np.abs(self.velocity) <= self._fastest).all(axis=1)
                ).tolist():
                    lost.setdefault(
                        copy,
                        Divergence(
                            copy,
                            float(self.time[copy]),
                            too_fast(self.velocity[copy], self._fastest),
                        ),
                    )
                    self.reset([copy])
        self.reset(lost)
        return [lost[copy] for copy in sorted(lost)]

    def close(self) -> None:
        """Release the clients; to close twice does nothing."""
        self._disconnect()
        self._equation.close()

    def _push(self, copy: int, command: Array) -> None:
        """Give Bullet the joint forces of a copy's next step."""
        body = self._bodies[copy]
        place = self.position[copy]
        mass, bias = self._equation.terms(
            self._asked[copy], body.angles, body.turning, body.rates, place[3:7]
        )
        load = self._load(copy) if self._loads.active else None
        if load is not None:
            turn = rotation_matrix(place[3:7]).T
            bias = bias - np.concatenate([turn @ load[3:6], turn @ load[:3], load[6:]])
        if self._rubs:
            self._bound_friction(copy)
        joint_forces(
            self._numbers[copy],
            mass,
            bias,
            place[7:],
            self._rates[copy],
            command,
            self._step,
            self._tails,
            self._bound,
            self._tension[copy],
            self._friction[copy],
            self._motors,
            self._servo,
            self._force,
        )
        if self._motors and len(command):
            body.drive(command.tolist(), np.abs(self._servo).tolist())
        if load is not None:
            self._force += load[6:]
            body.pull_base(place[:3].tolist(), load[:3].tolist(), load[3:6].tolist())
        body.push(self._force.tolist())

    def _bound_friction(self, copy: int) -> None:
        """Set where a copy's cables rub in the coming step, and how much at most."""
        cables, capstan, one = len(self._servo), self._capstan, slice(copy, copy + 1)
        hinges, pulls = self.position[one, 7 + cables :], self.pulls[one]
        coefficient = self._plant.guide_friction[one]
        tension, friction = pulls[:, :cables], pulls[:, cables:]
        self._bound = capstan.bounds(coefficient, hinges, tension, friction)[0]
        self._tails = capstan.tails(hinges)[0]

    def _load(self, copy: int) -> Array:
        """Return the generalized force of the loads on a copy, shape (nv,)."""
        return self._loads.generalized(self.position[[copy]], np.array([copy]))[0]

    def _write(self, copy: int) -> None:
        """Give Bullet the position and velocity of a copy."""
        body = self._bodies[copy]
        body.write(self.position[copy], self.velocity[copy])
        body.read(self.position[copy], self.velocity[copy])


def _disconnect(clients: list[int]) -> None:
    for client in clients:
        pybullet.disconnect(physicsClientId=client)


@compiled()
def _advance(time: Array, step: float, velocity: Array, fastest: Array) -> bool:
    """Add a step to the times of all copies, and return whether every coordinate is a number and no
    faster than allowed."""
    for copy in range(time.size):
        time[copy] += step
    for row in velocity:
        for k in range(row.size):
            if not abs(row[k]) <= fastest[k]:
                return False
    return True
