"""The backbone of a segment, an elastic rod: links and joints follow from its material."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, Strict, model_validator

from cdcsr.robot.parts import Angle, Joint, Link, NonNegative, Part, Positive, Torsion


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
    """nu, which has no unit."""
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
