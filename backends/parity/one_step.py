"""Level 2: one step from the same state, so that no error accumulates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backends.parity.checks import Check, Engines, reference_of
from backends.parity.trajectories import Commands
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Snapshot, State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """What is compared after a step."""

    name: str
    unit: str
    read: Callable[[State], Array]
    """(N, k), of which the norm of the difference is taken."""
    tolerances: dict[int, float]
    """By percentile of the difference, as a part of the quantity's own 95th percentile."""


_TYPICAL, _RARE = 0.01, 0.1
QUANTITIES = (
    Quantity("tip velocity", "m/s", lambda state: state.tip_velocity, {50: _TYPICAL, 95: _RARE}),
    Quantity("base velocity", "m/s", lambda state: state.base_velocity, {50: _TYPICAL, 95: _RARE}),
    Quantity(
        "base angular velocity",
        "rad/s",
        lambda state: state.base_angular_velocity,
        {50: _TYPICAL, 95: _RARE},
    ),
    # A cable that becomes taut within a step pulls in one engine at once and in another in the next step. So the
    # largest differences of tension are as large as tensions, and only how often that is depends on the commands.
    Quantity("tension", "N", lambda state: state.cable_tension, {50: _TYPICAL}),
)


@dataclass(frozen=True)
class OneStep:
    """Differences after one step from every state along some commands, one entry a state."""

    commands: str
    pair: str
    differences: dict[str, Array]
    """(M,) by quantity."""
    sizes: dict[str, Array]
    """(M,) norm of the quantity itself in the reference engine."""

    def checks(self) -> list[Check]:
        """One for each quantity and percentile that has a tolerance."""
        checks = []
        for q in QUANTITIES:
            size = float(np.percentile(self.sizes[q.name], 95))
            for percentile, tolerance in q.tolerances.items():
                value = float(np.percentile(self.differences[q.name], percentile))
                name = f"{q.name}, {'median' if percentile == 50 else f'{percentile} %'}"
                checks.append(
                    Check(2, name, f"{self.pair}, {self.commands}", value, tolerance * size, q.unit)
                )
        return checks

    def as_dict(self) -> dict[str, Any]:
        """The distributions as plain data."""
        rows = {}
        for q in QUANTITIES:
            difference, size = self.differences[q.name], self.sizes[q.name]
            median, high = np.percentile(difference, [50, 95])
            rows[q.name] = {
                "unit": q.unit,
                "median": float(median),
                "p95": float(high),
                "max": float(difference.max()),
                "size_p95": float(np.percentile(size, 95)),
            }
        first = next(iter(self.differences.values()))
        return {
            "commands": self.commands,
            "pair": self.pair,
            "states": len(first),
            "differences": rows,
        }


def states_along(robot: Robot, engines: Engines, commands: Commands) -> list[Snapshot]:
    """The states of all copies before each step of a run in the reference engine, as snapshots of no engine."""
    simulation = engines[reference_of(engines)](robot, len(commands.values))
    states = []
    for command in commands.values.swapaxes(0, 1):
        states.append(replace(simulation.get_snapshot(), engine=""))
        simulation.step(command)
    simulation.close()
    return states


def one_step(
    robot: Robot,
    engines: Engines,
    commands: Commands,
    progress: Callable[[int], object] | None = None,
) -> list[OneStep]:
    """Step every engine from the same states under the same commands; the others are compared with the reference.

    Args:
        robot: the description.
        engines: the reference first.
        commands: along which the states lie, and under which the step is made.
        progress: called with the number of steps just made.
    """
    reference, num = reference_of(engines), len(commands.values)
    states = states_along(robot, engines, commands)
    simulations = {name: make(robot, num) for name, make in engines.items()}
    after: dict[str, dict[str, list[Array]]] = {
        name: {q.name: [] for q in QUANTITIES} for name in engines
    }
    for snapshot, command, active in zip(
        states, commands.values.swapaxes(0, 1), commands.active, strict=True
    ):
        for name, simulation in simulations.items():
            simulation.set_snapshot(snapshot)
            simulation.step(command)
            state = simulation.state()
            for q in QUANTITIES:
                after[name][q.name].append(q.read(state)[active])
        if progress:
            progress(num)
    for simulation in simulations.values():
        simulation.close()
    found = {name: {q: np.concatenate(rows) for q, rows in after[name].items()} for name in engines}
    sizes = {q: np.linalg.norm(values, axis=1) for q, values in found[reference].items()}
    return [
        OneStep(
            commands.name,
            f"{name} - {reference}",
            {q: np.linalg.norm(found[name][q] - found[reference][q], axis=1) for q in sizes},
            sizes,
        )
        for name in engines
        if name != reference
    ]
