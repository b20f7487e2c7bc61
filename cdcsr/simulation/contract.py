"""The contract of every engine: `num` independent copies of one robot, stepped together.

The first axis of every array is the copy. Coordinates have one order: base linear, base angular
(both in the world frame), sliders, hinges from root to tip. In shapes, C is the number of cables, J
that of links, H that of hinges and nv = 6 + C + H. A fixed base keeps its coordinates, at rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.arguments import (
    as_command,
    as_floats,
    check_copies,
    check_count,
    chosen_copies,
)
from cdcsr.simulation.cameras import camera_angles
from cdcsr.simulation.declarations import Capability, EngineOptions, Physics, check_abilities
from cdcsr.simulation.delay_line import DelayLine
from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Parameters, Plant
from cdcsr.simulation.state import Array, Dynamics, Snapshot, State
from cdcsr.simulation.turns import taking_turns

Ids = Sequence[int] | NDArray[np.integer] | NDArray[np.bool_] | None
"""Which copies: sorted unique indices, a mask of shape (num,), or None for all copies."""


@taking_turns
class Simulation(ABC):
    """`num` copies of a robot in one engine; they start still, with hinges at their rest angles.

    Commands, shape (num, C), are as :class:`cdcsr.robot.servo.Servo` says; engines do not clip
    them. After `close()` all else raises :class:`CdcsrError`. What `copy` and `pickle` make is its
    own. Several threads may call one simulation; calls wait for each other.

    Args:
        robot: the description.
        num: how many copies.
        options: how the engine steps; None for its defaults.

    Attributes:
        plant: the numbers that `set_parameters` changes; read them only.
        loads: what `set_loads` changes; read it only.

    Raises:
        CdcsrError: num is below 1, or the engine cannot simulate such a robot.
    """

    engine: ClassVar[str]
    """The name that chooses the engine, as in `--backend`."""
    title: ClassVar[str]
    """The engine's name as it is written in text."""
    capabilities: ClassVar[frozenset[Capability]]
    variant_of: ClassVar[str | None] = None
    """The engine whose model files this one runs. Studies train in engines with None here."""
    version: ClassVar[str] = "unknown"
    physics: ClassVar[Physics] = Physics()
    options_type: ClassVar[type[EngineOptions]] = EngineOptions
    """The class of the options, each with its default, its bounds and a docstring."""
    switches: ClassVar[Mapping[str, str]] = {}
    """Options' values, each of which sets one of the engine's settings to the description's."""
    copy_memory: ClassVar[float] = 0.0
    """About how much memory a copy takes, in bytes."""

    def __init__(self, robot: Robot, num: int = 1, options: EngineOptions | None = None) -> None:
        self.options = options or self.options_type()
        check_copies(num, self.engine, self.copy_memory, self.options.free_memory)
        self.robot, self.num = robot, num
        self.plant: Plant = Parameters().plant(robot, num)
        self.check_robot(robot, self.plant, self.options)
        self.loads = Loads(robot, num)
        self._closed = False
        self._line = DelayLine(num, robot.num_cables)

    @property
    def ideal(self) -> bool:
        """Whether the motion converges to that of the description's ideal cables and dampers, as
        the time step shrinks."""
        return True

    def set_parameters(self, ids: Ids, parameters: Parameters) -> None:
        """Set how copies differ from the description, until it is set again.

        Parameters act from the next step on; neither reset nor a snapshot changes them. A new delay
        takes commands sent before the first delay as zero.

        Args:
            ids: which copies.
            parameters: their arrays have as many rows as there are `ids`.

        Raises:
            CdcsrError: a parameter has the wrong shape, is out of range, or is not for this engine.
        """
        chosen = self._chosen(ids)
        plant, delay = parameters.plant(self.robot, len(chosen)), parameters.delay(len(chosen))
        check_abilities(self.engine, self.capabilities, self.robot, plant)
        for mine, new in zip(self.plant, plant, strict=True):
            mine[chosen] = new
        self._line.set_delay(chosen, delay)
        self._set_plant(chosen, plant)

    def set_loads(
        self,
        ids: Ids,
        link: int,
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        point: ArrayLike | None = None,
        slot: int = 0,
    ) -> None:
        """Let a force and a torque act on a link from the next step on, until they are set again.

        Reset and snapshots do not change them. Vectors have the shape (3,), or (n, 3) for n copies.

        Args:
            ids: which copies.
            link: its number, from 0 at the base; -1 is the last one.
            force: in the world frame, in [N].
            torque: in the world frame, in [N m].
            point: where the force acts, in the link's frame (origin at its joint, z along it), in
                [m]; by default the centre of mass. The point moves with the link.
            slot: tells loads on one link apart; what is set again is the load of this slot.

        Raises:
            CdcsrError: there is no such link, or a vector is wrong.
        """
        self.loads.set(self._chosen(ids), link, force, torque, point, slot)
        self._set_loads()

    def reset(self, ids: Ids = None) -> None:
        """Put copies back to the start: hinges at their rest angles, no motion, time zero.

        Other copies and all parameters stay as they are. If a parameter has shortened a cable, its
        slider begins where the cable is just taut.
        """
        chosen = self._chosen(ids)
        self._stop_commands(chosen)
        self._reset(chosen)

    def place(self, ids: Ids, position: Array, velocity: Array) -> None:
        """Put copies into a state at time zero, with no commands under way and no tension so far.

        Other copies and all parameters stay as they are.

        Args:
            ids: which copies; n of them.
            position: as in a :class:`Snapshot`, shape (n, 7 + C + H).
            velocity: in the order of coordinates, shape (n, nv).

        Raises:
            CdcsrError: an array has the wrong shape, or a number in it is not finite.
        """
        chosen, size = self._chosen(ids), self.robot.num_coordinates
        position = as_floats("The position", position, (len(chosen), size + 1))
        velocity = as_floats("The velocity", velocity, (len(chosen), size))
        self._stop_commands(chosen)
        self._place(chosen, position, velocity)

    def step(self, command: Array, substeps: int = 1) -> None:
        """Advance all copies by `substeps` time steps under one command.

        Raises:
            CdcsrError: the command has not the shape (num, C), or a number in it is not finite or
                too large for an engine.
            Diverged: copies left the range in which their numbers mean anything. The others have
                made all steps; reset those before the next step.
        """
        self._check_open()
        command = as_command(command, self.plant.servo_gain.shape)
        check_count("substeps", substeps, 1_000_000_000)
        if self._line.idle:
            self._step(command, substeps)
            return
        lost: list[Diverged] = []
        for _ in range(substeps):
            try:
                self._step(self._line.push(command), 1)
            except Diverged as error:  # the other copies still get all substeps
                lost.append(error)
        if lost:
            lost[0].copies = tuple(sorted({copy for error in lost for copy in error.copies}))
            raise lost[0]

    def state(self) -> State:
        """Return the state of all copies. Its arrays do not change when the simulation goes on."""
        self._check_open()
        return self._state()

    def get_snapshot(self) -> Snapshot:
        """Return all that determines the future of all copies, except for robot and parameters."""
        self._check_open()
        snapshot = self._get_snapshot()
        return snapshot if self._line.idle else replace(snapshot, commands=self._line.sent)

    def set_snapshot(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot of the same robot, made by any engine; parameters stay as they are.

        Raises:
            CdcsrError: it is of another robot or another number of copies.
        """
        self._check_open()
        if snapshot.robot != self.robot.fingerprint:
            raise CdcsrError(
                f"The snapshot is of robot {snapshot.robot}; this simulation runs "
                f"{self.robot.fingerprint}."
            )
        if len(snapshot.time) != self.num:
            raise CdcsrError(
                f"The snapshot holds {len(snapshot.time)} copies; this simulation has {self.num}."
            )
        size = self.robot.num_coordinates
        as_floats("The snapshot's position", snapshot.position, (self.num, size + 1), finite=False)
        as_floats("The snapshot's velocity", snapshot.velocity, (self.num, size), finite=False)
        sent = snapshot.commands
        self._line.sent = np.zeros((self.num, 0, self.robot.num_cables)) if sent is None else sent
        try:
            self._set_snapshot(snapshot)
        except ValueError as error:
            raise CdcsrError(f"The snapshot does not fit the engine: {error}.") from None

    def dynamics(self, ids: Ids = None) -> Dynamics:
        """Return the equation of motion of some copies, from this engine's own model."""
        return self._dynamics(self._chosen(ids))

    def render(
        self, index: int = 0, camera: str = "side", target: ArrayLike | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture of one copy, shape (HEIGHT, WIDTH, 3) of `cdcsr.simulation.cameras`.

        Args:
            index: which copy.
            camera: a name in :data:`cdcsr.simulation.cameras.CAMERAS`.
            target: a point to mark, world frame, in [m].

        Raises:
            CdcsrError: there is no such copy or camera, or the engine cannot draw here.
        """
        self._check_open()
        check_count("The index of a copy", index, self.num - 1, least=0)
        camera_angles(camera)
        points = np.zeros((0, 3)) if target is None else as_floats("The target", target, (3,))
        return self._render(index, camera, points.reshape(-1, 3))

    def close(self) -> None:
        """Release what the engine holds; to close twice does nothing."""
        if not self._closed:
            self._closed = True
            self._close()

    def __reduce__(self) -> tuple[object, ...]:
        self._check_open()
        described = Parameters().plant(self.robot, self.num)
        changed = any((own != of).any() for own, of in zip(self.plant, described, strict=True))
        plant = self.plant if changed else None
        parts = type(self), self.robot, self.num, self.options, plant, self._line, self.loads
        return rebuild, (*parts, self._get_snapshot())

    # What an engine implements. Arguments are checked, commands already delayed, copies in order.

    @abstractmethod
    def _set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Set the numbers of copies `ids` for the next step and for `dynamics`."""

    @abstractmethod
    def _set_loads(self) -> None:
        """Take note that `loads` has changed; `_step` and `dynamics` must apply it."""

    @abstractmethod
    def _state(self) -> State: ...

    @abstractmethod
    def _dynamics(self, ids: NDArray[np.int64]) -> Dynamics: ...

    @abstractmethod
    def _render(self, index: int, camera: str, targets: Array) -> NDArray[np.uint8]: ...

    @abstractmethod
    def _close(self) -> None: ...

    @abstractmethod
    def _reset(self, ids: NDArray[np.int64]) -> None: ...

    @abstractmethod
    def _place(self, ids: NDArray[np.int64], position: Array, velocity: Array) -> None: ...

    @abstractmethod
    def _step(self, command: Array, substeps: int) -> None: ...

    @abstractmethod
    def _get_snapshot(self) -> Snapshot: ...

    @abstractmethod
    def _set_snapshot(self, snapshot: Snapshot) -> None: ...

    def _stop_commands(self, ids: NDArray[np.int64]) -> None:
        """Set the commands under way to copies that are back at the start to zero."""
        self._line.fill(ids, np.zeros((len(ids), self.robot.num_cables)))

    def _diverged(self, copies: Sequence[int], time: float, what: str) -> Diverged:
        """Return the error of copies that diverged, the first at a time in [s]."""
        what += f"; springs are stable below a time_step of {stable_step(self.robot):.2g} s"
        return Diverged(self.engine, copies[0], time, what, copies)

    @classmethod
    def check_robot(cls, robot: Robot, plant: Plant, options: EngineOptions) -> None:
        """Raise CdcsrError if the engine lacks an ability that a robot needs."""
        del options  # engines whose abilities depend on them read them
        check_abilities(cls.engine, cls.capabilities, robot, plant)

    def _check_open(self) -> None:
        if self._closed:
            raise CdcsrError(f"This {self.engine} simulation is closed; make a new one.")

    def _chosen(self, ids: Ids) -> NDArray[np.int64]:
        self._check_open()
        return chosen_copies(ids, self.num)


def rebuild(
    kind: type[Simulation],
    robot: Robot,
    num: int,
    options: EngineOptions | None,
    plant: Plant | None,
    line: DelayLine,
    loads: Loads,
    snapshot: Snapshot,
) -> Simulation:
    """Make the copy of a simulation, for the modules `copy` and `pickle`."""
    simulation = kind(robot, num, options)
    if plant is not None:
        for mine, own in zip(simulation.plant, plant, strict=True):
            mine[:] = own
        simulation._set_plant(np.arange(num), plant)
    simulation._line, simulation.loads = line, loads
    simulation._set_loads()
    simulation._set_snapshot(snapshot)
    return simulation
