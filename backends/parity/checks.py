"""What parity is held to: a measured value, its tolerance, and where it was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation

Array = NDArray[np.float64]
Engines = Mapping[str, Callable[[Robot, int], Simulation]]
"""Makes simulations of a number of copies, by engine; the first engine is the reference."""


@dataclass(frozen=True)
class Check:
    """A value that must not leave its tolerance."""

    level: int
    """1 one state, 2 one step, 3 open loop."""
    name: str
    """The quantity."""
    pair: str
    """Who is compared with whom."""
    value: float
    tolerance: float
    unit: str
    """Of value and tolerance; "relative" for a ratio."""
    where: str = ""
    """The coordinate or cable where it is worst, if it has one."""
    at_least: bool = False
    """Whether the tolerance is a lower bound."""

    @property
    def passed(self) -> bool:
        """False also for a value that is not a number."""
        return self.value >= self.tolerance if self.at_least else self.value <= self.tolerance

    def __str__(self) -> str:
        bound = "at least" if self.at_least else "at most"
        place = f", worst at {self.where}" if self.where else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"level {self.level}, {self.name}, {self.pair}: {self.value:.2g}{unit} "
            f"({bound} {self.tolerance:.3g}{unit}{place})"
        )

    def as_dict(self) -> dict[str, Any]:
        """The check as plain data; a value that is not a number becomes None."""
        data = self.__dict__ | {"passed": bool(self.passed)}
        return data | {"value": self.value if np.isfinite(self.value) else None}


def reference_of(engines: Engines) -> str:
    """The engine the others are compared with."""
    return next(iter(engines))
