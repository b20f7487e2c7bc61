"""Speed measurements that only one engine can make of itself, for `cdcsr bench`.

An engine brings any number of them by entry points in the group `cdcsr.benchmarks`. The name of an
entry point is the name of the section, and it loads a :data:`Section`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot

_GROUP = "cdcsr.benchmarks"


@dataclass(frozen=True)
class Measurement:
    """One printed row of a section."""

    name: str
    """The key of the value in the JSON file."""
    value: float | None
    """A ratio, or a quantity whose unit `what` tells; None if it could not be measured."""
    what: str
    """One line that says what was measured."""
    floor: str = ""
    """How fast the machine itself is at it, which shows whether the machine was busy."""
    lines: tuple[str, ...] = ()
    """A table to print below the row."""
    details: Mapping[str, object] = field(default_factory=dict)
    """More values for the JSON file, ready for JSON."""


Section = Callable[[Robot, NDArray[np.float64]], Iterable[Measurement]]
"""Measures with a robot and a demonstrator's commands, shape (episodes, steps, C), in [m]."""


def engine_sections() -> dict[str, Callable[[], Section]]:
    """Return what loads each section that the installed engines bring, by the section's name."""
    points = sorted(entry_points(group=_GROUP), key=lambda point: point.name)
    return {point.name: point.load for point in points}
