"""A check of parity: a measured value, its tolerance, and where it was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation

Engines = Mapping[str, Callable[[Robot, int], Simulation]]
"""Make simulations of a number of copies, by engine; the first engine is the reference."""


@dataclass(frozen=True)
class Check:
    """A value and its tolerance."""

    level: int
    """1: one state, 2: one step, 3: open loop."""
    name: str
    """The quantity."""
    pair: str
    """The engine, or the two that are compared."""
    value: float
    tolerance: float
    unit: str
    """The unit of value and tolerance; "relative" for a ratio."""
    where: str = ""
    """The coordinate or cable with the worst value, if there is one."""
    at_least: bool = False
    """Whether the tolerance is a lower bound."""

    @property
    def passed(self) -> bool:
        """Whether the value is within the tolerance; NaN is not."""
        return self.value >= self.tolerance if self.at_least else self.value <= self.tolerance

    @property
    def bound(self) -> str:
        """The tolerance in words."""
        return f"at {'least' if self.at_least else 'most'} {self.tolerance:.3g}"

    def __str__(self) -> str:
        place = f", worst at {self.where}" if self.where else ""
        unit = f" {self.unit}" if self.unit else ""
        measured = f"level {self.level}, {self.name}, {self.pair}: {self.value:.2g}{unit}"
        return f"{measured} ({self.bound}{unit}{place})"

    def as_dict(self) -> dict[str, object]:
        """Return the check as plain data for JSON; NaN and infinity become None."""
        value = self.value if np.isfinite(self.value) else None
        return {**asdict(self), "passed": bool(self.passed), "value": value}


def reference_of(engines: Engines) -> str:
    """Return the name of the engine that the others are compared with."""
    return next(iter(engines))
