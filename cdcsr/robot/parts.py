"""One link of the arm and its joint, in numbers, and the base of all sections of a description."""

from __future__ import annotations

from math import pi
from typing import Annotated, ClassVar, Literal, NamedTuple, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    Strict,
    model_serializer,
    model_validator,
)

from cdcsr.errors import CdcsrError
from cdcsr.robot.mesh_files import MeshName

_Given = TypeVar("_Given")

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Angle = Annotated[float, Field(gt=0, le=pi)]
LowAngle = Annotated[float, Field(ge=-pi, le=0)]
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

    later: ClassVar[tuple[str, ...]] = ()
    """The keys of fields that came after the first version. They are not written while they have
    their default, so that the fingerprints of older descriptions stay the same."""

    @model_serializer(mode="wrap")
    def _without_later_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        written = {}
        for name, value in handler(self).items():
            field = type(self).model_fields[name]
            key = field.alias or name
            if key not in self.later or getattr(self, name) != field.default:
                written[key] = value
        return written


def there(part: _Given | None, name: str) -> _Given:
    """Return a part or number of a section.

    Raises:
        CdcsrError: the section does not have it.
    """
    if part is None:
        raise CdcsrError(f"This part of the robot has no {name}.")
    return part


class Link(Part):
    """One rigid link: a cylinder along z with its joint at the lower end."""

    later = ("center", "mesh")
    length: Positive
    """In [m]."""
    radius: Positive
    """In [m]."""
    mass: Positive
    """In [kg]."""
    inertia: Inertia
    """Principal moments about the link's centre of mass in [kg m^2]."""
    center: NonNegative | None = None
    """Height of the centre of mass above the joint, in [m]; without it, half of the length."""
    mesh: MeshName | None = None
    """Its look: a mesh file in [m], origin at the joint, +z along the link."""

    def scaled(self, radius: float, mass: float) -> Link:
        """Return a link of so many times the radius and the mass: its moments across grow with the
        mass, that along the link with the mass and the radius squared."""
        x, y, z = (moment * mass for moment in self.inertia)
        own = {"radius": self.radius * radius, "mass": self.mass * mass}
        return Link.model_validate(dict(self) | own | {"inertia": (x, y, z * radius**2)})

    @property
    def center_of_mass(self) -> float:
        """Height above the joint in [m]."""
        return self.length / 2 if self.center is None else self.center


class Torsion(Part):
    """A hinge about z, with which a link twists."""

    later = ("lower", "rest")
    stiffness: NonNegative
    """In [N m/rad]."""
    damping: NonNegative
    """In [N m s/rad]."""
    limit: Angle
    """Largest angle in [rad]; to the other side the same, unless `lower` is given."""
    lower: LowAngle | None = None
    """Lowest angle in [rad]."""
    rest: float = 0.0
    """Rest angle of the spring in [rad]; the arm starts there."""

    @model_validator(mode="after")
    def _rests_inside(self) -> Self:
        _check_rest(self.hinge)
        return self

    @property
    def hinge(self) -> Hinge:
        """The hinge itself."""
        lower = -self.limit if self.lower is None else self.lower
        return Hinge("z", self.stiffness, self.damping, lower, self.limit, self.rest)


class Joint(Part):
    """The hinges below a link: two crossed ones for bending, or one for bending in a plane; and one
    for torsion if it is given."""

    later = ("order", "torsion", "lower", "rest")
    stiffness: NonNegative
    """Stiffness of each bending hinge, in [N m/rad]."""
    damping: NonNegative
    """Damping of each bending hinge, in [N m s/rad]."""
    limit: Angle
    """Largest angle of a bending hinge in [rad]; to the other side the same, unless `lower` is
    given."""
    lower: LowAngle | None = None
    """Lowest angle of a bending hinge in [rad]."""
    order: Literal["xy", "yx", "x", "y"] = "xy"
    """The axes of the bending hinges, the lower one first; a single one bends in a plane. A hinge
    for torsion lies above them."""
    rest: Annotated[tuple[float, ...], Strict(False)] = ()
    """Rest angle of the spring of each bending hinge in [rad], in the same order; without it, zero.
    The arm starts there."""
    torsion: Torsion | None = None

    @model_validator(mode="after")
    def _rests_inside(self) -> Self:
        if self.rest and len(self.rest) != len(self.order):
            raise ValueError(
                f"rest must have {len(self.order)} angles, one for each hinge in order = "
                f"{self.order!r}, not {len(self.rest)}"
            )
        for hinge in self.hinges:
            _check_rest(hinge)
        return self

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """The hinges in order, the lowest first."""
        lower = -self.limit if self.lower is None else self.lower
        found = tuple(
            Hinge(axis, self.stiffness, self.damping, lower, self.limit, rest)
            for axis, rest in zip(self.order, self.rest or (0.0, 0.0), strict=False)
        )
        return found if self.torsion is None else (*found, self.torsion.hinge)


class Hinge(NamedTuple):
    """One hinge of the arm."""

    axis: str
    """`x`, `y` or `z`, in the frame of the link that it carries while all angles are zero."""
    stiffness: float
    """In [N m/rad]."""
    damping: float
    """In [N m s/rad]."""
    lower: float
    """Lowest angle in [rad], zero or negative."""
    upper: float
    """Largest angle in [rad], positive."""
    rest: float = 0.0
    """Angle at which its spring is at rest, and at which it starts, in [rad]."""


def _check_rest(hinge: Hinge) -> None:
    if not hinge.lower <= hinge.rest <= hinge.upper:
        raise ValueError(
            f"rest must lie between {hinge.lower:g} and {hinge.upper:g} rad, where the hinge about "
            f"{hinge.axis} stops, not at {hinge.rest:g}"
        )


def joined(lower: Link, upper: Link) -> Link:
    """Return two pieces, one on top of the other, as one rigid link."""
    both = carrying(lower, upper.mass, upper.inertia, lower.length + upper.center_of_mass)
    radius = max(lower.radius, upper.radius)
    return both.model_copy(update={"length": lower.length + upper.length, "radius": radius})


def carrying(link: Link, mass: float, inertia: tuple[float, float, float], height: float) -> Link:
    """Return a link with a body fixed on its axis.

    Args:
        link: without the body.
        mass: of the body, in [kg].
        inertia: its moments about its own centre of mass, in [kg m^2].
        height: of that centre above the link's joint, in [m].
    """
    total = link.mass + mass
    center = (link.mass * link.center_of_mass + mass * height) / total
    shift = link.mass * (link.center_of_mass - center) ** 2 + mass * (height - center) ** 2
    x, y, z = (a + b for a, b in zip(link.inertia, inertia, strict=True))
    changes = {"mass": total, "inertia": (x + shift, y + shift, z), "center": center}
    return link.model_copy(update=changes)
