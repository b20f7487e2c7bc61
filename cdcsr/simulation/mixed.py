"""Several engines side by side in one simulation, so that a policy can learn in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import EngineOptions, Simulation, rebuild
from cdcsr.simulation.delay_line import DelayLine
from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Plant
from cdcsr.simulation.state import Array, Dynamics, Snapshot, State

Part = tuple[type[Simulation], EngineOptions]
Rows = NDArray[np.int64]


class MixedSimulation(Simulation):
    """`num` copies dealt out to K engines in turn: engine k has the copies k, k + K, k + 2K, ...

    :func:`mixed_engine` makes a subclass for some engines. Each copy moves as it does in its own
    engine alone.

    Raises:
        CdcsrError: one of the engines cannot simulate the robot.
    """

    parts: ClassVar[Sequence[Part]]
    """The engines, each with its options."""

    def __init__(self, robot: Robot, num: int = 1, options: EngineOptions | None = None) -> None:
        super().__init__(robot, num, options)
        kinds = len(self.parts)
        self._rows = [np.arange(k, num, kinds) for k in range(min(kinds, num))]
        self._parts = [
            kind(robot, len(rows), options)
            for (kind, options), rows in zip(self.parts, self._rows, strict=False)
        ]

    @property
    def ideal(self) -> bool:
        return all(part.ideal for part in self._parts)

    def __reduce__(self) -> tuple[object, ...]:
        self._check_open()
        described = self.engine, self.parts, self.robot, self.plant, self._line, self.loads
        return _rebuild, (*described, self._get_snapshot())

    def _of_parts(self, ids: Rows) -> list[tuple[Simulation, Rows, Rows]]:
        """Return each engine with some of `ids`, their numbers in it, and their places in `ids`."""
        kinds = len(self.parts)
        places = [np.flatnonzero(ids % kinds == k) for k in range(len(self._parts))]
        found = zip(self._parts, places, strict=True)
        return [(part, ids[at] // kinds, at) for part, at in found if len(at)]

    def _set_plant(self, ids: Rows, plant: Plant) -> None:
        for part, own, at in self._of_parts(ids):
            rows = Plant(*(numbers[at] for numbers in plant))
            for mine, new in zip(part.plant, rows, strict=True):
                mine[own] = new
            part._set_plant(own, rows)

    def _set_loads(self) -> None:
        for part, rows in zip(self._parts, self._rows, strict=True):
            part.loads = self.loads.of_copies(rows)
            part._set_loads()

    def _state(self) -> State:
        states = [part._state() for part in self._parts]
        return State(
            **{
                field.name: self._joined([getattr(state, field.name) for state in states])
                for field in fields(State)
            }
        )

    def _dynamics(self, ids: Rows) -> Dynamics:
        found = [(part._dynamics(own), at) for part, own, at in self._of_parts(ids)]
        order = np.argsort(np.concatenate([at for _, at in found]))
        return Dynamics(
            **{
                field.name: np.concatenate([getattr(one, field.name) for one, _ in found])[order]
                for field in fields(Dynamics)
            }
        )

    def _render(self, index: int, camera: str, targets: Array) -> NDArray[np.uint8]:
        kinds = len(self.parts)
        return self._parts[index % kinds]._render(index // kinds, camera, targets)

    def _close(self) -> None:
        for part in self._parts:
            part.close()

    def _reset(self, ids: Rows) -> None:
        for part, own, _ in self._of_parts(ids):
            part._reset(own)

    def _place(self, ids: Rows, position: Array, velocity: Array) -> None:
        for part, own, at in self._of_parts(ids):
            part._place(own, position[at], velocity[at])

    def _step(self, command: Array, substeps: int) -> None:
        lost: list[tuple[Diverged, Rows]] = []
        for part, rows in zip(self._parts, self._rows, strict=True):
            try:
                part._step(command[rows], substeps)
            except Diverged as error:  # the other engines still make their steps
                lost.append((error, rows))
        if lost:
            first, rows = lost[0]
            copies = [int(numbers[c]) for error, numbers in lost for c in error.copies]
            raise Diverged(first.engine, int(rows[first.copy]), first.time, first.what, copies)

    def _get_snapshot(self) -> Snapshot:
        """Return a snapshot; `private` holds what each engine needs, filled up with zeros."""
        snapshots = [part._get_snapshot() for part in self._parts]
        private = [one.private.reshape(len(one.time), -1) for one in snapshots]
        widest = max(rows.shape[1] for rows in private)
        padded = [np.pad(rows, [(0, 0), (0, widest - rows.shape[1])]) for rows in private]
        return Snapshot(
            engine=self.engine,
            robot=self.robot.fingerprint,
            time=self._joined([one.time for one in snapshots]),
            position=self._joined([one.position for one in snapshots]),
            velocity=self._joined([one.velocity for one in snapshots]),
            private=self._joined(padded),
        )

    def _set_snapshot(self, snapshot: Snapshot) -> None:
        own = snapshot.engine == self.engine
        for part, rows in zip(self._parts, self._rows, strict=True):
            part_of = Snapshot(
                *(snapshot.engine, snapshot.robot, snapshot.time[rows]),
                *(snapshot.position[rows], snapshot.velocity[rows], snapshot.private[rows]),
            )
            if own:
                shape = part._get_snapshot().private.shape
                width = int(np.prod(shape[1:]))
                private = part_of.private[:, :width].reshape(shape)
                part_of = replace(part_of, engine=part.engine, private=private)
            part._set_snapshot(part_of)

    def _joined(self, of_parts: list[Array]) -> Array:
        """Put the rows of all engines into the order of the copies."""
        first = of_parts[0]
        joined = np.empty((self.num, *first.shape[1:]), first.dtype)
        for rows, values in zip(self._rows, of_parts, strict=True):
            joined[rows] = values
        return joined


_made: dict[str, type[MixedSimulation]] = {}
"""The classes by name, so that each name has one."""


def _rebuild(
    name: str,
    parts: Sequence[Part],
    robot: Robot,
    plant: Plant,
    line: DelayLine,
    loads: Loads,
    snapshot: Snapshot,
) -> Simulation:
    """Make the copy of a simulation, for `copy` and `pickle`; a made class cannot be pickled."""
    kind, num = mixed_engine(name, parts), len(snapshot.time)
    return rebuild(kind, robot, num, None, plant, line, loads, snapshot)


def mixed_engine(name: str, parts: Sequence[Part]) -> type[MixedSimulation]:
    """Return the class of a simulation in several engines.

    Args:
        name: the engines' names with their options, joined by "+".
        parts: the engines, each with its options.
    """
    if name not in _made:
        kinds = [kind for kind, _ in parts]
        abilities = frozenset.intersection(*(kind.capabilities for kind in kinds))
        if any("soft_cables" in kind.capabilities for kind in kinds):
            abilities |= {"soft_cables"}
        described = {
            "__doc__": MixedSimulation.__doc__,
            "engine": name,
            "title": " and ".join(kind.title for kind in kinds),
            "capabilities": abilities,
            "version": ", ".join(f"{kind.engine} {kind.version}" for kind in kinds),
            "parts": tuple(parts),
        }
        _made[name] = type("Mixed", (MixedSimulation,), described)
    return _made[name]
