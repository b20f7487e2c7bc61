"""Second plants: the ways in which the plant a policy is measured on may differ from the one it was trained on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Parameters


@dataclass(frozen=True)
class SecondPlant:
    """A plant to measure a policy on; with the policy's own robot and nothing else given, its own plant."""

    robot: Robot
    """What is simulated. It may differ from the policy's in every number, not in its joints and cables."""
    parameters: Parameters | None = None
    """How all copies differ from that robot, if they do."""
    substeps: int = 1
    """Time steps of that robot in one of the policy's robot, so that the control period stays what it was."""
    observation_delay: int = 0
    """How many actions old an observation is when it arrives."""
    own_settings: bool = False
    """Step as the engine does by itself: see :meth:`cdcsr.simulation.contract.Simulation.use_own_settings`."""
    own_cables: bool = False
    """Hold cables as the engine does by itself, with the softness of the robot's description."""


@dataclass(frozen=True)
class Axis:
    """One way to be wrong, and how wrong to be."""

    name: str
    about: str
    unit: str
    """Of the levels; "factor" for factors on the description's number, which 1 leaves alone."""
    up: tuple[float, ...]
    """Levels above nominal, outwards; the last one is the cap."""
    down: tuple[float, ...]
    """Levels below nominal, outwards."""
    build: Callable[[Robot, float], SecondPlant]
    """The plant at a level."""
    idle: frozenset[str] = frozenset()
    """Engines to which it means nothing: there is the same plant at all levels."""

    @property
    def title(self) -> str:
        """For a figure or a table."""
        words = self.name.replace("_", " ")
        return words if self.unit == "switch" else f"{words} [{self.unit}]"

    @property
    def nominal(self) -> float:
        """The level at which nothing is wrong."""
        return 1.0 if self.unit == "factor" else 0.0

    @property
    def levels(self) -> tuple[float, ...]:
        """All levels: nominal, then outwards up, then outwards down."""
        return (self.nominal, *self.up, *self.down)

    def plant(self, robot: Robot, level: float) -> SecondPlant:
        """The plant at a level.

        Raises:
            CdcsrError: it is none that this axis can be at.
        """
        if level == self.nominal:
            return SecondPlant(robot)
        return self.build(robot, level)

    def between(self, a: float, b: float, share: float) -> float:
        """The level that lies a share of the way from a to b: by ratio for factors, else by difference."""
        if self.unit == "factor" and min(a, b) > 0:
            return exp(log(a) + share * (log(b) - log(a)))
        return a + share * (b - a)


_UP = (1.25, 1.6, 2.0, 3.0, 5.0, 10.0)
_DOWN = (0.8, 0.625, 0.5, 0.33, 0.2, 0.1)
_DELAYS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


def _factor(name: str, about: str) -> Axis:
    """An axis that is a factor of :class:`Parameters`."""
    return Axis(
        name, about, "factor", _UP, _DOWN, lambda robot, level: _with_parameter(robot, name, level)
    )


def _with_parameter(robot: Robot, name: str, level: float) -> SecondPlant:
    return SecondPlant(robot, Parameters(**{name: level}))


def _whole(name: str, level: float) -> int:
    if level != int(level):
        raise CdcsrError(f"{name} counts whole steps, not {level:g}.")
    return int(level)


def _softer(robot: Robot, level: float) -> SecondPlant:
    """MuJoCo's soft limits instead of cables that hold: their recovery time times `level`, and their compliance
    (1 - d) / d, where d is the impedance, too."""
    data = robot.model_dump()
    data["constraint"]["recovery_time"] *= level
    impedance = robot.mujoco.impedance
    data["mujoco"]["impedance"] = 1 / (1 + level * (1 - impedance) / impedance)
    return SecondPlant(Robot.model_validate(data), own_cables=True)


def _time_step(robot: Robot, level: float) -> SecondPlant:
    """The time step times `level`, of which a whole number makes the control period."""
    substeps = round(1 / level) if 0 < level < 1 else 0
    if substeps < 1 or abs(substeps * level - 1) > 1e-9:
        raise CdcsrError(
            f"time_step must be 1 over a whole number, so that the control period stays; found {level:g}."
        )
    return SecondPlant(
        robot.model_copy(update={"time_step": robot.time_step / substeps}), substeps=substeps
    )


def _own_settings(robot: Robot, level: float) -> SecondPlant:
    if level != 1:
        raise CdcsrError(
            f"engine_defaults is 0 (settings that agree) or 1 (the engine's own), not {level:g}."
        )
    return SecondPlant(robot, own_settings=True)


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
            "how much all cables are stretched; negative is shortened",
            "m",
            (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
            (-0.005, -0.01, -0.02, -0.05, -0.1, -0.19),
            lambda robot, level: _with_parameter(robot, "rest_length_offset", level),
        ),
        Axis(
            "command_delay",
            "time steps until a command acts",
            "steps",
            _DELAYS,
            (),
            lambda robot, level: SecondPlant(
                robot, Parameters(command_delay=_whole("command_delay", level))
            ),
        ),
        Axis(
            "observation_delay",
            "actions until an observation arrives",
            "actions",
            _DELAYS,
            (),
            lambda robot, level: SecondPlant(
                robot, observation_delay=_whole("observation_delay", level)
            ),
        ),
        Axis(
            "cable_softness",
            "recovery time and compliance of MuJoCo's own soft cables (PyBullet's cables do not stretch)",
            "factor",
            (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0),
            (),
            _softer,
            frozenset({"pybullet"}),
        ),
        Axis(
            "time_step",
            "the second plant's time step; a coarser one would change the control period",
            "factor",
            (),
            (0.5, 0.25, 0.125),
            _time_step,
        ),
        Axis(
            "engine_defaults",
            "the engine's own settings instead of those that agree",
            "switch",
            (1.0,),
            (),
            _own_settings,
        ),
    )
}
"""Every way to be wrong, by its name."""


def find_axes(names: tuple[str, ...]) -> list[Axis]:
    """The axes of those names; "all" stands for all.

    Raises:
        CdcsrError: there is no such axis, or none is named.
    """
    if not names:
        raise CdcsrError(f"No axis is named; name some of {', '.join(AXES)}, or all.")
    for name in names:
        if name != "all" and name not in AXES:
            raise CdcsrError(unknown_choice("axis", name, [*AXES, "all"]))
    return [axis for axis in AXES.values() if axis.name in names or "all" in names]
