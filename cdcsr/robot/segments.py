"""A segment of the arm: its links, its cables and their servos."""

from __future__ import annotations

from typing import Annotated, Self, TypeVar

from pydantic import Field, Strict, model_validator

from cdcsr.errors import CdcsrError
from cdcsr.robot.parts import Backbone, Joint, Link, NonNegative, Part, Positive

_Section = TypeVar("_Section", bound=Part)


class Cables(Part):
    """The cables that end at the top of one segment."""

    angles_deg: Annotated[tuple[float, ...], Strict(False), Field(min_length=1)]
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
    """Distance of the slider at rest below the cable's first guide, in [m]; above its radius."""

    @property
    def stop(self) -> float:
        """The travel at which the slider touches the cable's first guide and stops, in [m]."""
        return self.offset - self.radius


class Segment(Part):
    """A group of links and the cables that end on the last of them.

    Its links are equal and given by `link` and `joint`, or they are parts of a `backbone`. Without
    `cables` and `servo` the segment is passive.
    """

    later = ("link", "joint", "backbone", "cables", "servo")
    links: Annotated[int, Field(ge=1)]
    own_link: Link | None = Field(None, alias="link")
    own_joint: Joint | None = Field(None, alias="joint")
    backbone: Backbone | None = None
    own_cables: Cables | None = Field(None, alias="cables")
    own_servo: Servo | None = Field(None, alias="servo")

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        given = [part is not None for part in (self.own_link, self.own_joint, self.backbone)]
        if given not in ([True, True, False], [False, False, True]):
            raise ValueError("needs either link and joint, or backbone")
        if (self.own_cables is None) != (self.own_servo is None):
            raise ValueError("needs cables and servo, or neither")
        return self

    @property
    def link(self) -> Link:
        """The link of a segment that has no backbone."""
        return _there(self.own_link, "link: it is given by its backbone")

    @property
    def joint(self) -> Joint:
        """The joint of a segment that has no backbone."""
        return _there(self.own_joint, "joint: it is given by its backbone")

    @property
    def cables(self) -> Cables:
        """The cables of a segment that is not passive."""
        return _there(self.own_cables, "cables: it is passive")

    @property
    def servo(self) -> Servo:
        """The servo of each cable of a segment that is not passive."""
        return _there(self.own_servo, "servo: it is passive")

    @property
    def cable_angles(self) -> tuple[float, ...]:
        """The direction of each of its cables around z, in degrees from x; none if passive."""
        return () if self.own_cables is None else self.own_cables.angles_deg

    @property
    def stub(self) -> Link | None:
        """The part below its first joint: half a cell of a backbone."""
        return self.backbone and self.backbone.piece(self.backbone.length / self.links / 2)

    @property
    def chain(self) -> list[tuple[Link, Joint]]:
        """Its links with their joints, without the next segment's stub."""
        if self.backbone is None:
            return [(self.link, self.joint)] * self.links
        cell = self.backbone.length / self.links
        lengths = [cell] * (self.links - 1) + [cell / 2]
        return [
            (self.backbone.piece(length), self.backbone.joint(self.links, n))
            for n, length in enumerate(lengths)
        ]


def _there(part: _Section | None, name: str) -> _Section:
    if part is None:
        raise CdcsrError(f"This segment has no {name}.")
    return part
