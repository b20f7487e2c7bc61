"""One link of the arm and its joint, given in numbers or by the material of a backbone."""

from __future__ import annotations

from math import pi
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

from cdcsr.robot.mesh_files import MeshName

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

    A tapered rod has the radius R at its lower end and `end_radius` at the other, in between
    linearly, and the inner radius in proportion. Its pieces are frustums, and a hinge is as
    compliant as its cell: l / (E I) becomes the integral of 1 / (E I) over the cell.
    """

    later = ("end_radius", "curvature", "twist")
    length: Positive
    """Length of the whole segment, in [m]."""
    youngs_modulus: Positive
    """In [Pa]."""
    poissons_ratio: Annotated[float, Field(gt=-1, le=0.5)]
    density: Positive
    """In [kg/m^3]."""
    radius: Positive
    """R, outer radius in [m]; of a tapered rod at its lower end."""
    end_radius: Positive | None = None
    """Outer radius of a tapered rod at its upper end, in [m]."""
    inner_radius: NonNegative = 0.0
    """r, in [m]; zero for a solid rod."""
    damping_time: NonNegative
    """Damping divided by stiffness, in [s]."""
    limit: Angle = 1.5
    """Largest angle of each hinge to either side in [rad]."""
    torsion: bool = True
    """Whether links can twist."""
    curvature: Annotated[tuple[float, float], Strict(False)] = (0.0, 0.0)
    """Curvature at rest about x and y, in [rad/m]."""
    twist: float = 0.0
    """Twist at rest, in [rad/m]."""

    @model_validator(mode="after")
    def _is_a_tube(self) -> Self:
        if self.inner_radius >= self.radius:
            raise ValueError(f"inner_radius must be below radius ({self.radius:g} m)")
        if self.twist and not self.torsion:
            raise ValueError("twist needs torsion = true")
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
        cell = self.length / cells
        low, high = (self._radius_at(n * cell) for n in (number, number + 1))
        # The integral of 1 / R^4 over the cell, as a multiple of that at its lower end.
        soft = (low**2 + low * high + high**2) * self.radius**4 / (3 * low**3 * high**3)
        bend, twist = (
            k * cells / self.length / (soft if self.end_radius else 1.0)
            for k in (self.bending_stiffness, self.torsional_stiffness)
        )
        torsion = Torsion(
            stiffness=twist,
            damping=self.damping_time * twist,
            limit=self.limit,
            rest=self.twist * cell,
        )
        order = "yx" if number.bit_count() % 2 else "xy"
        return Joint(
            stiffness=bend,
            damping=self.damping_time * bend,
            limit=self.limit,
            order=order,
            rest=tuple(self.curvature["xy".index(axis)] * cell for axis in order),
            torsion=torsion if self.torsion else None,
        )

    def piece(self, length: float, start: float = 0.0) -> Link:
        """Return a piece of the rod as a rigid link that begins at the height `start`."""
        if self.end_radius is not None:
            return self._frustum(length, self._radius_at(start), self._radius_at(start + length))
        squares = self.radius**2 + self.inner_radius**2
        mass = self.density * np.pi * (self.radius**2 - self.inner_radius**2) * length
        across = mass * (3 * squares + length**2) / 12
        return Link(
            length=length,
            radius=self.radius,
            mass=mass,
            inertia=(across, across, mass * squares / 2),
        )

    def _radius_at(self, height: float) -> float:
        """Return the outer radius at a height above the rod's lower end, in [m]."""
        end = self.radius if self.end_radius is None else self.end_radius
        return self.radius + (end - self.radius) * height / self.length

    def _frustum(self, length: float, low: float, high: float) -> Link:
        """Return a hollow frustum of the radii `low` and `high` as a link.

        With R linear along it, the mean of R^2 is (a^2 + a b + b^2) / 3, those of R^2 z and R^2 z^2
        follow in the same way, and a slice has the moments of a disc.
        """
        inner = self.inner_radius / self.radius
        area, shape = np.pi * (1 - inner**2), np.pi * (1 - inner**4)
        second = (low**2 + low * high + high**2) / 3
        fourth = sum(low**k * high ** (4 - k) for k in range(5)) / 5
        center = length * (low**2 + 2 * low * high + 3 * high**2) / 12 / second
        spread = length**2 * (low**2 + 3 * low * high + 6 * high**2) / 30 / second
        mass = self.density * area * second * length
        disc = self.density * shape * fourth * length / 4
        across = disc + mass * (spread - center**2)
        return Link(
            length=length,
            radius=(low + high) / 2,
            mass=mass,
            inertia=(across, across, 2 * disc),
            center=center,
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
        mesh=lower.mesh,
    )
