"""Model errors: the ways in which the plant may differ from the model a policy was trained on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import exp, log

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import rounded, ruler
from cdcsr.simulation.plant import Parameters


@dataclass(frozen=True)
class ActualPlant:
    """The plant that a controller is measured on; with only `robot` given, the model itself."""

    robot: Robot
    """The robot that is simulated. It has the model's joints and cables; all numbers may differ."""
    parameters: Parameters | None = None
    """How all copies differ from that robot; None if they do not."""
    substeps: int = 1
    """How many time steps of the plant make one of the model, so that the control period stays."""
    observation_delay: int = 0
    """The age of an observation when it arrives, in actions."""


@dataclass(frozen=True)
class Axis:
    """One kind of model error, and the levels at which it is measured."""

    name: str
    about: str
    unit: str
    """The unit of the levels; "factor" if they multiply the description's number."""
    up: tuple[float, ...]
    """The levels above nominal, outwards, for the paper's robot; the last one is the largest
    measured."""
    down: tuple[float, ...]
    """The levels below nominal, outwards, likewise."""
    build: Callable[[Robot, float], ActualPlant]
    """Makes the plant at a level."""

    @property
    def title(self) -> str:
        """The name for figures and tables."""
        return f"{self.name.replace('_', ' ')} [{self.unit}]"

    @property
    def nominal(self) -> float:
        """The level without an error."""
        return 1.0 if self.unit == "factor" else 0.0

    @property
    def levels(self) -> tuple[float, ...]:
        """All levels: nominal, then outwards up, then outwards down."""
        return (self.nominal, *self.up, *self.down)

    def on(self, robot: Robot) -> Axis:
        """Return the same axis with levels for a robot: lengths and strains by its ruler, and none
        that leaves its sliders no room."""
        own, room = ruler(robot), min((servo.stop for servo in robot.servos), default=0.0)
        unit = {"m": own.travel, "1/N": 1 / own.pull}.get(self.unit, 1.0)
        up, down = (tuple(rounded(unit * x) for x in side) for side in (self.up, self.down))
        if self.name == "rest_length_offset":
            down = tuple(x for x in down if -x <= room + 1e-9)
        return replace(self, up=up, down=down)

    def plant(self, robot: Robot, level: float) -> ActualPlant:
        """Return the plant at a level.

        Raises:
            CdcsrError: the level is none of this axis.
        """
        if level == self.nominal:
            return ActualPlant(robot)
        return self.build(robot, level)

    def between(self, a: float, b: float, share: float) -> float:
        """Interpolate between levels a and b: by ratio for factors, else by difference."""
        if self.unit == "factor" and min(a, b) > 0:
            return exp(log(a) + share * (log(b) - log(a)))
        return a + share * (b - a)


_UP = (1.25, 1.6, 2.0, 3.0, 5.0, 10.0)
_DOWN = (0.8, 0.625, 0.5, 0.33, 0.2, 0.1)
_DELAYS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


def _factor(name: str, about: str) -> Axis:
    """Make the axis of a factor in :class:`Parameters`."""
    return Axis(
        name, about, "factor", _UP, _DOWN, lambda robot, level: _with_parameter(robot, name, level)
    )


def _with_parameter(robot: Robot, name: str, level: float) -> ActualPlant:
    return ActualPlant(robot, Parameters(**{name: level}))


def _whole(name: str, level: float) -> int:
    if level != int(level):
        raise CdcsrError(f"{name} must be a whole number of steps, not {level:g}.")
    return int(level)


def _time_step(robot: Robot, level: float) -> ActualPlant:
    """Multiply the time step by `level`; a whole number of steps must make the control period."""
    substeps = round(1 / level) if 0 < level < 1 else 0
    if substeps < 1 or abs(substeps * level - 1) > 1e-9:
        raise CdcsrError(
            "time_step must be 1 over a whole number, so that the control period stays; "
            f"found {level:g}."
        )
    return ActualPlant(
        robot.model_copy(update={"time_step": robot.time_step / substeps}), substeps=substeps
    )


AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        _factor("link_mass", "mass of all links"),
        _factor("link_inertia", "moments of inertia of all links about their centres"),
        _factor("base_mass", "mass of the base"),
        _factor("base_inertia", "moments of inertia of the base"),
        _factor("joint_stiffness", "springs of all hinges"),
        _factor("joint_damping", "dampers of all hinges"),
        _factor("servo_gain", "gain of all servos"),
        _factor("slider_damping", "friction of all sliders"),
        Axis(
            "rest_length_offset",
            "what is added to the rest length of all cables; negative is shortened",
            "m",
            (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
            (-0.005, -0.01, -0.02, -0.05, -0.1, -0.19),
            lambda robot, level: _with_parameter(robot, "rest_length_offset", level),
        ),
        Axis(
            "cable_strain",
            "what is added to the strain of all cables by tension, 1 / (E A)",
            "1/N",
            (1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3),
            (),
            lambda robot, level: _with_parameter(robot, "cable_strain", level),
        ),
        Axis(
            "guide_friction",
            "what is added to the coefficient of friction of all cables in their guides",
            "1",
            (0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
            (),
            lambda robot, level: _with_parameter(robot, "guide_friction", level),
        ),
        Axis(
            "command_delay",
            "time steps until a command acts",
            "steps",
            _DELAYS,
            (),
            lambda robot, level: ActualPlant(
                robot, Parameters(command_delay=_whole("command_delay", level))
            ),
        ),
        Axis(
            "observation_delay",
            "actions until an observation arrives",
            "actions",
            _DELAYS,
            (),
            lambda robot, level: ActualPlant(
                robot, observation_delay=_whole("observation_delay", level)
            ),
        ),
        Axis(
            "time_step",
            "time step of the plant; a coarser one would change the control period",
            "factor",
            (),
            (0.5, 0.25, 0.125),
            _time_step,
        ),
    )
}
"""Every kind of model error, by name."""


def find_axes(names: tuple[str, ...]) -> list[Axis]:
    """Return the axes of some names; "all" stands for all axes.

    Raises:
        CdcsrError: there is no axis of that name, or no name is given.
    """
    if not names:
        raise CdcsrError(f"No axis is given; name some of {', '.join(AXES)}, or all.")
    for name in names:
        if name != "all" and name not in AXES:
            raise CdcsrError(unknown_choice("axis", name, [*AXES, "all"]))
    return [axis for axis in AXES.values() if axis.name in names or "all" in names]
