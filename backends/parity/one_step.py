"""Level 2: one step from the same state, so that no error accumulates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from backends.parity.checks import Check, Engines, reference_of
from backends.parity.trajectories import Commands
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array, Snapshot, State


@dataclass(frozen=True)
class Quantity:
    """A quantity that is compared after a step."""

    name: str
    unit: str
    read: Callable[[State], Array]
    """Reads it from a state, shape (N, k); differences are measured by their norm."""
    tolerances: dict[int, float]
    """Tolerances of percentiles of the difference, as a part of the quantity's 95th percentile."""


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
    # A cable that becomes taut within a step can pull at once in one engine and in the next step in
    # another. So the largest differences of tension are as large as tensions; the commands decide
    # how often this happens.
    Quantity("tension", "N", lambda state: state.cable_tension, {50: _TYPICAL}),
)


class Distribution(TypedDict):
    """The distribution of a quantity's differences."""

    unit: str
    median: float
    p95: float
    """The 95th percentile."""
    max: float
    size_p95: float
    """The 95th percentile of the quantity itself."""


@dataclass(frozen=True)
class OneStep:
    """The differences after one step from each of M states along some commands."""

    commands: str
    pair: str
    differences: dict[str, Array]
    """The norms of the differences by quantity, shape (M,)."""
    sizes: dict[str, Array]
    """The norms of the quantities themselves in the reference engine, shape (M,)."""
    soft: bool = False
    """Whether cables stretch in one of the engines, so that one step already differs much."""

    def checks(self) -> list[Check]:
        """Return a check for each quantity and percentile that has a tolerance; none for engines
        with soft cables."""
        checks = []
        if self.soft:
            return checks
        for q in QUANTITIES:
            size = float(np.percentile(self.sizes[q.name], 95))
            for percentile, tolerance in q.tolerances.items():
                value = float(np.percentile(self.differences[q.name], percentile))
                name = f"{q.name}, {'median' if percentile == 50 else f'{percentile} %'}"
                checks.append(
                    Check(2, name, f"{self.pair}, {self.commands}", value, tolerance * size, q.unit)
                )
        return checks

    @property
    def states(self) -> int:
        """How many states there are."""
        return len(next(iter(self.differences.values())))

    def distributions(self) -> dict[str, Distribution]:
        """Return the distribution of each quantity's differences."""
        rows: dict[str, Distribution] = {}
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
        return rows

    def as_dict(self) -> dict[str, object]:
        """Return the distributions as plain data for JSON."""
        return {
            "commands": self.commands,
            "pair": self.pair,
            "states": self.states,
            "differences": self.distributions(),
        }


def states_along(robot: Robot, engines: Engines, commands: Commands) -> list[Snapshot]:
    """Return the states before each step of a run in the reference engine, as snapshots of no
    engine."""
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
    """Step every engine from the same states under the same commands, and compare the results.

    Args:
        robot: the description.
        engines: the engines, the reference first.
        commands: the states lie along them in the reference engine; each step is made under the
            command of its state.
        progress: called with the number of steps just made.

    Returns:
        The comparison of each other engine with the reference.
    """
    reference, num = reference_of(engines), len(commands.values)
    states = states_along(robot, engines, commands)
    simulations = {name: make(robot, num) for name, make in engines.items()}
    soft = {name for name, each in simulations.items() if "soft_cables" in each.capabilities}
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
            soft=not soft.isdisjoint({name, reference}),
        )
        for name in engines
        if name != reference
    ]
