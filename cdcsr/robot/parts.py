"""One link of the arm and its joint, given in numbers or by the material of a backbone."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
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

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Angle = Annotated[float, Field(gt=0, le=3.141592653589793)]
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


class Link(Part):
    """One rigid link: a cylinder along z with its joint at the lower end."""

    later = ("center",)
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

    @property
    def center_of_mass(self) -> float:
        """Height above the joint in [m]."""
        return self.length / 2 if self.center is None else self.center


class Torsion(Part):
    """A hinge about z, with which a link twists."""

    stiffness: NonNegative
    """In [N m/rad]; the rest angle is zero."""
    damping: NonNegative
    """In [N m s/rad]."""
    limit: Angle
    """Largest angle to either side in [rad]."""


class Joint(Part):
    """The hinges below a link: two crossed ones for bending, and one for torsion if it is given."""

    later = ("order", "torsion")
    stiffness: NonNegative
    """Stiffness of each bending hinge, in [N m/rad]; the rest angle is zero."""
    damping: NonNegative
    """Damping of each bending hinge, in [N m s/rad]."""
    limit: Angle
    """Largest angle of a bending hinge to either side in [rad]."""
    order: Literal["xy", "yx"] = "xy"
    """The axes of the bending hinges, the lower one first. A hinge for torsion lies above both."""
    torsion: Torsion | None = None

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """The hinges in order, the lowest first."""
        bending = (self.stiffness, self.damping, self.limit)
        found = tuple(Hinge(axis, *bending) for axis in self.order)
        if self.torsion is None:
            return found
        twist = self.torsion
        return (*found, Hinge("z", twist.stiffness, twist.damping, twist.limit))


class Hinge(NamedTuple):
    """One hinge of the arm."""

    axis: str
    """`x`, `y` or `z`, in the frame of the link that it carries while all angles are zero."""
    stiffness: float
    """In [N m/rad]."""
    damping: float
    """In [N m s/rad]."""
    limit: float
    """Largest angle to either side in [rad]."""


class Backbone(Part):
    """An elastic rod, from whose material links and joints follow.

    The rod is divided into as many equal cells as the segment has links, with a joint in the middle
    of each cell. So half a cell is rigid with what is below, and half a cell with what is above;
    this makes the shape exact to the second order in the number of links. The half cell at the base
    is rigid with the base: count its mass in the base's. Where two segments meet, two half cells
    make one link.

    With the cell's length l, Young's modulus E and the shear modulus G = E / (2 (1 + nu)), each
    bending hinge has the stiffness E I / l and the torsion hinge G J / l, where I = pi (R^4 - r^4)
    / 4 and J = 2 I (S. Timoshenko, "Strength of Materials"). A damper is the stiffness times the
    damping time (a Kelvin-Voigt material).
    """

    length: Positive
    """Length of the whole segment, in [m]."""
    youngs_modulus: Positive
    """In [Pa]."""
    poissons_ratio: Annotated[float, Field(gt=-1, le=0.5)]
    density: Positive
    """In [kg/m^3]."""
    radius: Positive
    """R, outer radius in [m]."""
    inner_radius: NonNegative = 0.0
    """r, in [m]; zero for a solid rod."""
    damping_time: NonNegative
    """Damping divided by stiffness, in [s]."""
    limit: Angle = 1.5
    """Largest angle of each hinge to either side in [rad]."""
    torsion: bool = True
    """Whether links can twist."""

    @model_validator(mode="after")
    def _is_a_tube(self) -> Self:
        if self.inner_radius >= self.radius:
            raise ValueError(f"inner_radius must be below radius ({self.radius:g} m)")
        return self

    @property
    def bending_stiffness(self) -> float:
        """E I in [N m^2]."""
        return self.youngs_modulus * np.pi * (self.radius**4 - self.inner_radius**4) / 4

    @property
    def torsional_stiffness(self) -> float:
        """G J in [N m^2]."""
        return self.bending_stiffness / (1 + self.poissons_ratio)

    def joint(self, cells: int, number: int) -> Joint:
        """Return the joint in the middle of cell `number`.

        In a joint that bends about x and then about y the two bendings make a twist of the second
        order; bending about y first makes the opposite one. So that they cancel along the rod, also
        where they change, the order follows the Thue-Morse sequence: xy yx yx xy yx xy xy yx ...
        """
        bend, twist = (
            k * cells / self.length for k in (self.bending_stiffness, self.torsional_stiffness)
        )
        torsion = Torsion(stiffness=twist, damping=self.damping_time * twist, limit=self.limit)
        return Joint(
            stiffness=bend,
            damping=self.damping_time * bend,
            limit=self.limit,
            order="yx" if number.bit_count() % 2 else "xy",
            torsion=torsion if self.torsion else None,
        )

    def piece(self, length: float) -> Link:
        """Return a piece of the rod as a rigid link."""
        squares = self.radius**2 + self.inner_radius**2
        mass = self.density * np.pi * (self.radius**2 - self.inner_radius**2) * length
        across = mass * (3 * squares + length**2) / 12
        return Link(
            length=length,
            radius=self.radius,
            mass=mass,
            inertia=(across, across, mass * squares / 2),
        )


def joined(lower: Link, upper: Link) -> Link:
    """Return two pieces, one on top of the other, as one rigid link."""
    mass = lower.mass + upper.mass
    heights = lower.center_of_mass, lower.length + upper.center_of_mass
    center = (lower.mass * heights[0] + upper.mass * heights[1]) / mass
    shift = lower.mass * (heights[0] - center) ** 2 + upper.mass * (heights[1] - center) ** 2
    x, y, z = (a + b for a, b in zip(lower.inertia, upper.inertia, strict=True))
    return Link(
        length=lower.length + upper.length,
        radius=max(lower.radius, upper.radius),
        mass=mass,
        inertia=(x + shift, y + shift, z),
        center=center,
    )
