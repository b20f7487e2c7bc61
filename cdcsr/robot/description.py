"""The description of a cable-driven continuum space robot, read from and written to TOML.

A robot is a base, free-floating or fixed, with a serial arm of rigid links. Each link hangs on a
joint at its lower end: two crossed hinges, first about x, then about y, or one hinge; and it can
have one more for torsion. Links are grouped into segments, given by their numbers or by the
material of a backbone, and every segment may have cables of its own. A cable runs from a
servo-driven slider inside the base through two guides on each link that it passes, to its anchor:
the upper guide of the last link of its own segment.

Lengths in [m], masses in [kg], angles in [rad] unless a name says degrees. The arm points along +z.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import (
    Field,
    ModelWrapValidatorHandler,
    Strict,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.reading import MOST_TEXT, read_text
from cdcsr.robot.parts import (
    Hinge,
    Joint,
    Link,
    Part,
    Positive,
    Vector,
    carrying,
    joined,
)
from cdcsr.robot.scale import Scale
from cdcsr.robot.section_rules import errors_between_sections
from cdcsr.robot.sections import Base, Constraint, MujocoOptions, Payload, Workspace
from cdcsr.robot.segments import Segment
from cdcsr.robot.servo import Servo
from cdcsr.robot.toml_errors import describe_all, report_again, without_echoes


class Robot(Part):
    """The description of a robot; :func:`load_robot` loads one."""

    later = ("gravity", "payload", "scale")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=64)]
    """Lower-case letters, digits and hyphens."""
    time_step: Positive
    """Simulation step in [s]."""
    gravity: Vector = (0.0, 0.0, 0.0)
    """The acceleration of free fall, in the world frame, in [m/s^2]."""
    base: Base
    constraint: Constraint
    workspace: Workspace
    segments: Annotated[tuple[Segment, ...], Strict(False), Field(min_length=1)]
    payload: Payload | None = None
    """The tip carries nothing without it."""
    mujoco: MujocoOptions = MujocoOptions()
    scale: Scale = Scale()
    """Numbers of the tasks; by default they follow from the arm's length and pace."""

    if TYPE_CHECKING:  # Pydantic gives frozen models a hash, of which type checkers do not know.

        def __hash__(self) -> int: ...

    @model_validator(mode="wrap")
    @classmethod
    def _check_across_sections(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Check rules between sections, and report what breaks them along with all other errors."""
        robot: Self | None = None
        errors: list[InitErrorDetails] = []
        try:
            robot = handler(data)
        except ValidationError as error:
            errors += [report_again(line) for line in without_echoes(error.errors())]
        errors += errors_between_sections(data if robot is None else robot.model_dump())
        if robot is None or errors:
            raise ValidationError.from_exception_data(cls.__name__, errors)
        return robot

    @property
    def num_segments(self) -> int:
        return len(self.segments)

    @property
    def links(self) -> tuple[tuple[Link, Joint], ...]:
        """All links with their joints, from the base to the tip; the last with the payload."""
        chain: list[tuple[Link, Joint]] = []
        for segment in self.segments:
            if chain and segment.stub is not None:
                link, joint = chain[-1]
                chain[-1] = joined(link, segment.stub), joint
            chain += segment.pairs
        if self.payload is not None:
            (link, joint), load = chain[-1], self.payload
            height = link.length + load.offset
            chain[-1] = carrying(link, load.mass, load.inertia, height), joint
        return tuple(chain)

    @property
    def num_links(self) -> int:
        return len(self.links)

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """All hinges from the base to the tip."""
        return tuple(hinge for _, joint in self.links for hinge in joint.hinges)

    @property
    def start_angles(self) -> tuple[float, ...]:
        """The angle of each hinge at the start, where its spring is at rest, in [rad]."""
        return tuple(hinge.rest for hinge in self.hinges)

    @property
    def leaders(self) -> tuple[int, ...]:
        """The number of the hinge whose angle each hinge always has: its own, or, where a segment
        is coupled, that of the segment's first hinge about the same axis."""
        found: list[int] = []
        for segment in self.segments:
            first: dict[str, int] = {}
            for _, joint in segment.pairs:
                for hinge in joint.hinges:
                    number = len(found)
                    coupled = segment.coupling and hinge.axis != "z"
                    found.append(first.setdefault(hinge.axis, number) if coupled else number)
        return tuple(found)

    @property
    def link_of_hinge(self) -> tuple[int, ...]:
        """The number of the link that each hinge carries."""
        return tuple(n for n, (_, joint) in enumerate(self.links) for _ in joint.hinges)

    @property
    def num_hinges(self) -> int:
        return len(self.hinges)

    @property
    def servos(self) -> tuple[Servo, ...]:
        """The servo of each cable, segment by segment."""
        return tuple(s.servo for s in self.segments for _ in s.cable_angles)

    @property
    def full_commands(self) -> NDArray[np.float64]:
        """The command of each servo at its largest pull, shape (C,), in [m] or [N]."""
        return np.array([servo.full for servo in self.servos], dtype=float)

    @property
    def command_range(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lowest and the highest command of each servo, shape (C,): from zero to full."""
        return np.minimum(self.full_commands, 0.0), np.maximum(self.full_commands, 0.0)

    @property
    def strain_by_tension(self) -> tuple[float, ...]:
        """1 / (E A) of each cable, in [1/N]; zero for one that does not stretch."""
        stiffness = [s.cables.axial_stiffness for s in self.segments for _ in s.cable_angles]
        return tuple(0.0 if each is None else 1 / each for each in stiffness)

    @property
    def guide_friction(self) -> tuple[float, ...]:
        """The coefficient of friction of each cable in its guides."""
        return tuple(s.cables.guide_friction for s in self.segments for _ in s.cable_angles)

    @property
    def num_cables(self) -> int:
        return len(self.servos)

    @property
    def num_coordinates(self) -> int:
        """The number of coordinates: base (6, also if it is fixed), sliders, hinges."""
        return 6 + self.num_cables + self.num_hinges

    @property
    def top(self) -> float:
        """Height of the base's top face, where the arm begins, above the base's centre in [m]."""
        return self.base.size[2] / 2

    @property
    def first_joint(self) -> float:
        """Height of the first joint above the base's centre in [m]."""
        stub = self.segments[0].stub
        return self.top + (stub.length if stub else 0)

    @property
    def arm_length(self) -> float:
        """From the base's top face to the tip in [m]."""
        return self.first_joint - self.top + sum(link.length for link, _ in self.links)

    @property
    def total_mass(self) -> float:
        """In [kg]."""
        return (
            self.base.mass
            + sum(link.mass for link, _ in self.links)
            + sum(s.mass for s in self.servos)
        )

    @property
    def fingerprint(self) -> str:
        """A hash of every number that affects the motion; name, scale and looks do not."""
        looks = {"own_link": {"mesh"}, "own_chain": {"__all__": {"mesh"}}}
        others = {"name": True, "scale": True, "base": {"mesh"}, "segments": {"__all__": looks}}
        data = self.model_dump(mode="json", exclude=others)
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]

    def to_toml(self) -> str:
        """Return the description as TOML; reading it back gives an equal robot."""
        return tomli_w.dumps(self.model_dump(mode="json"))


def differences(own: Robot, other: Robot) -> str:
    """Return the fields in which two descriptions differ, at most six of them, as one line."""
    ours, theirs = (dict(_leaves(one.model_dump(mode="json"))) for one in (own, other))
    found = [
        f"{name} = {ours.get(name, 'none')}, not {theirs.get(name, 'none')}"
        for name in dict.fromkeys((*ours, *theirs))
        if name.split(".")[-1] not in ("name", "mesh") and ours.get(name) != theirs.get(name)
    ]
    more = f"; and {len(found) - 6} more" if len(found) > 6 else ""
    return "; ".join(found[:6]) + more


def _leaves(value: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield the values inside nested data with their dotted names."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}".lstrip("."))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{name}[{index}]")
    else:
        yield name, value


def parse_robot(text: str, source: str = "<text>") -> Robot:
    """Read a description from TOML text.

    Raises:
        CdcsrError: the text is not TOML, or breaks rules; the message lists every broken rule with
            its line.
    """
    text = text.removeprefix("\ufeff")  # a byte-order mark
    if len(text) > MOST_TEXT // 4:
        raise CdcsrError(f"{source} is no robot description: it has {len(text):,} characters.")
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also an integer of thousands of digits
        raise CdcsrError(f"{source} is not valid TOML: {error}.") from None
    try:
        return Robot.model_validate(data)
    except ValidationError as error:
        raise CdcsrError(f"{source}: {describe_all(text, error, Robot)}") from None


def load_robot(robot: str | Path) -> Robot:
    """Load a description from a file, or a shipped one by its name (``"paper"``).

    A text of several lines is a description itself.

    Raises:
        CdcsrError: no such file or shipped robot, or a broken description.
    """
    if isinstance(robot, str) and "\n" in robot:
        return parse_robot(robot, "The robot's description")
    path = Path(robot)
    if path.suffix == ".toml":
        found = parse_robot(read_text(path, "robot description"), str(path))
        _READ_FROM[found.name, found.fingerprint] = str(path)
        return found
    shipped = shipped_robots()
    if str(robot) not in shipped:
        raise CdcsrError(
            unknown_choice("robot", str(robot), shipped) + " Or give a path ending in .toml."
        )
    return parse_robot(
        (resources.files("models") / "robots" / f"{robot}.toml").read_text("utf-8"), f"{robot}.toml"
    )


_READ_FROM: dict[tuple[str, str], str] = {}
"""The files from which descriptions were read in this process, by name and fingerprint."""


def argument_of(robot: Robot) -> str:
    """Return the word with which a command line names a robot, as it can be pasted: its name if it
    is a shipped one, else the file that it was read from, or again its name."""
    key = robot.name, robot.fingerprint
    if robot.name in shipped_robots() and load_robot(robot.name).fingerprint == robot.fingerprint:
        return robot.name
    return shlex.quote(_READ_FROM.get(key, robot.name))


def folder_of(robot: Robot) -> Path | None:
    """Return the folder of the file that a description was read from, if that is known."""
    found = _READ_FROM.get((robot.name, robot.fingerprint))
    return Path(found).parent if found else None


def shipped_robots() -> list[str]:
    """Return the names of the robots that come with the package."""
    folder = resources.files("models") / "robots"
    return sorted(
        f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")
    )
