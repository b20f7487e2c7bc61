"""The description of a cable-driven continuum space robot, read from and written to TOML.

A robot is a free-floating base with a serial arm of rigid links. Each link hangs on a universal
joint at its lower end (two crossed hinges, first about x, then about y). Links are grouped into
segments, and every segment has its own cables. A cable runs from a servo-driven slider inside the
base through two guides on each link that it passes, to its anchor: the upper guide of the last link
of its own segment.

Lengths in [m], masses in [kg], angles in [rad] unless a name says degrees. The arm points along +z.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    Strict,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.reading import MOST_TEXT, read_text
from cdcsr.robot.section_rules import errors_between_sections
from cdcsr.robot.toml_errors import describe_all, report_again, without_echoes

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Vector = Annotated[tuple[float, float, float], Strict(False)]


def _possible_inertia(inertia: tuple[float, float, float]) -> tuple[float, float, float]:
    """Check that the moments are positive and that none exceeds the sum of the other two."""
    low, mid, high = sorted(inertia)
    if low <= 0:
        raise ValueError("principal moments of inertia must be positive")
    if high > (low + mid) * (1 + 1e-9):
        raise ValueError(
            f"no rigid body has this inertia: {high:g} exceeds {low:g} + {mid:g} "
            "(the largest principal moment is at most the sum of the other two)"
        )
    return inertia


Inertia = Annotated[Vector, AfterValidator(_possible_inertia)]


class Part(BaseModel):
    """A section of the description. It is frozen; unknown keys and wrong types are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Base(Part):
    """The free-floating base: a box whose centre is the world origin at the start."""

    size: Annotated[tuple[Positive, Positive, Positive], Strict(False)]
    """Edge lengths along x, y, z in [m]."""
    mass: Positive
    """Mass in [kg], sliders not included."""
    inertia: Inertia
    """Principal moments about the centre in [kg m^2]."""


class Link(Part):
    """One rigid link: a cylinder along z with its universal joint at the lower end."""

    length: Positive
    """In [m]."""
    radius: Positive
    """In [m]."""
    mass: Positive
    """In [kg]."""
    inertia: Inertia
    """Principal moments about the link's centre in [kg m^2]."""


class Joint(Part):
    """Each of the two crossed hinges of a link."""

    stiffness: NonNegative
    """In [N m/rad]; the rest angle is zero."""
    damping: NonNegative
    """In [N m s/rad]."""
    limit: Annotated[float, Field(gt=0, le=3.141592653589793)]
    """Largest angle of a hinge to either side in [rad]."""


class Cables(Part):
    """The cables that end at the top of one segment."""

    angles_deg: Annotated[tuple[float, ...], Strict(False), Field(min_length=3)]
    """Direction of each cable around z, in degrees from x."""
    pitch_radius: Positive
    """Distance of the cables from the arm's axis in [m]."""
    guide_offset: Positive
    """Distance of each guide from the nearer end of its link, in [m]; in the base, from the top
    face."""


class Servo(Part):
    """The slider that pulls one cable, and the position servo that moves it."""

    mass: Positive
    """Mass of the slider in [kg]."""
    damping: NonNegative
    """Viscous friction of the slider in [N s/m]."""
    gain: Positive
    """Servo force per set-point error in [N/m]."""
    eta: Positive
    """Largest pull: set-points lie in [-eta, 0], in [m]."""
    radius: Positive
    """The slider is a solid ball of this radius, in [m]."""
    offset: Positive
    """Distance of the slider at rest below the cable's first guide, in [m]."""


class Segment(Part):
    """A group of equal links and the cables that end on the last of them."""

    links: Annotated[int, Field(ge=1)]
    link: Link
    joint: Joint
    cables: Cables
    servo: Servo


class Constraint(Part):
    """Unilateral constraints: cables, never longer than at rest, and hinge limits."""

    recovery_time: Positive
    """The time constant with which an excess of length or angle decays, in [s]; at least two time
    steps."""


class Workspace(Part):
    """The cuboid of the Anchor Space, where the robot works."""

    center: Vector
    """In the world frame, in [m]."""
    size: Annotated[tuple[NonNegative, NonNegative, NonNegative], Strict(False)]
    """Edge lengths in [m]; zero for a plane or a line."""


class MujocoOptions(Part):
    """Numbers that only MuJoCo reads."""

    integrator: Literal["implicitfast", "implicit", "Euler"] = "implicitfast"
    """The integrator in the model files, for stock MuJoCo. The simulation does not read it: there
    dampers are implicit, and nothing else is."""
    impedance: Annotated[float, Field(gt=0, lt=1)] = 0.999
    """Impedance (solimp dmin = dmax) of hinge limits and, in the model files, of cables; 1 is
    rigid. Too close to 1, a taut cable of the model files that shortens by nanometres is slack for
    a step, in which nothing holds its slider."""


class Robot(Part):
    """The description of a robot; :func:`load_robot` loads one."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=64)]
    """Lower-case letters, digits and hyphens."""
    time_step: Positive
    """Simulation step in [s]."""
    base: Base
    constraint: Constraint
    workspace: Workspace
    segments: Annotated[tuple[Segment, ...], Strict(False), Field(min_length=1)]
    mujoco: MujocoOptions = MujocoOptions()

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
        """All links with their joints, from the base to the tip."""
        return tuple((s.link, s.joint) for s in self.segments for _ in range(s.links))

    @property
    def num_links(self) -> int:
        return len(self.links)

    @property
    def num_hinges(self) -> int:
        """Two for each link."""
        return 2 * self.num_links

    @property
    def servos(self) -> tuple[Servo, ...]:
        """The servo of each cable, segment by segment."""
        return tuple(s.servo for s in self.segments for _ in s.cables.angles_deg)

    @property
    def num_cables(self) -> int:
        return len(self.servos)

    @property
    def num_coordinates(self) -> int:
        """Degrees of freedom: base (6), sliders, hinges."""
        return 6 + self.num_cables + self.num_hinges

    @property
    def top(self) -> float:
        """Height of the base's top face, where the arm begins, above the base's centre in [m]."""
        return self.base.size[2] / 2

    @property
    def arm_length(self) -> float:
        """From the first joint to the tip in [m]."""
        return sum(link.length for link, _ in self.links)

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
        """A hash of every number that affects the motion; the name is not part of it."""
        data = self.model_dump(mode="json", exclude={"name"})
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]

    def to_toml(self) -> str:
        """Return the description as TOML; reading it back gives an equal robot."""
        return tomli_w.dumps(self.model_dump(mode="json"))


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

    Raises:
        CdcsrError: no such file or shipped robot, or a broken description.
    """
    path = Path(robot)
    if path.suffix == ".toml":
        return parse_robot(read_text(path, "robot description"), str(path))
    shipped = shipped_robots()
    if str(robot) not in shipped:
        raise CdcsrError(
            unknown_choice("robot", str(robot), shipped) + " Or give a path ending in .toml."
        )
    return parse_robot(
        (resources.files("models") / "robots" / f"{robot}.toml").read_text("utf-8"), f"{robot}.toml"
    )


def shipped_robots() -> list[str]:
    """Return the names of the robots that come with the package."""
    folder = resources.files("models") / "robots"
    return sorted(
        f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")
    )
