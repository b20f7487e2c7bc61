"""Declarations of an engine: its abilities, its options, and what in it is its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import BaseModel, ConfigDict

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Plant

Capability = Literal[
    "render",
    "bit_exact",
    "single_precision",
    "soft_cables",
    "elastic_cables",
    "servo_kinds",
    "guide_friction",
]
"""An ability that only some engines have. render: it has its own camera. bit_exact: the same
commands give the same bits, also after a snapshot. single_precision: it computes with seven digits.
soft_cables: cables under tension are longer than at rest, by millimetres. elastic_cables: cables
can be springs, by their axial stiffness. servo_kinds: servos can be of any kind, with a force limit
and a pretension. guide_friction: cables rub in their guides."""


def check_abilities(
    engine: str, abilities: frozenset[Capability], robot: Robot, plant: Plant
) -> None:
    """Check that an engine has the abilities that a robot and its plant need.

    Raises:
        CdcsrError: it lacks one.
    """
    if plant.cable_compliance.any() and "elastic_cables" not in abilities:
        raise CdcsrError(
            f"The engine {engine} has no elastic cables; leave out axial_stiffness and "
            "cable_strain, or choose an engine that has elastic_cables (see `cdcsr engines`)."
        )
    if plant.guide_friction.any() and "guide_friction" not in abilities:
        raise CdcsrError(
            f"The engine {engine} has no friction in guides; leave out guide_friction, or choose "
            "an engine that has it (see `cdcsr engines`)."
        )
    plain = all(s.kind == "set-point" and s.pull == s.gain * abs(s.full) for s in robot.servos)
    if not plain and "servo_kinds" not in abilities:
        raise CdcsrError(
            f"The engine {engine} has set-point servos only, without force_limit and pretension; "
            "choose an engine that has servo_kinds (see `cdcsr engines`)."
        )


class EngineOptions(BaseModel):
    """The options of an engine; the base class has none. Values may come as text."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    @property
    def steps(self) -> int:
        """How many steps of the engine make one time step of the robot."""
        return 1

    @property
    def free_memory(self) -> float | None:
        """How many bytes there are for copies; None where they are in this process's memory."""
        return None


_UNKNOWN = "not declared"


@dataclass(frozen=True)
class Physics:
    """Who computes each part of the motion: the physics package, or this project.

    Each text is short; it begins with "ours" where the project's own code decides the motion.
    """

    joint_dynamics: str = _UNKNOWN
    """From forces to accelerations: mass matrix, Coriolis and centrifugal forces."""
    integration: str = _UNKNOWN
    """From accelerations to the next state."""
    cables: str = _UNKNOWN
    """How cables are kept from getting longer than at rest."""
    limits: str = _UNKNOWN
    """How a hinge is stopped at its limit, and a slider at its guide."""
    servos: str = _UNKNOWN
    """How a slider is pulled to its set-point."""
    damping: str = _UNKNOWN
    """How the dampers of hinges and sliders enter a step."""
