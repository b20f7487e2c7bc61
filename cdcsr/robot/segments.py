"""A segment of the arm: its links, its cables and their servos."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, Strict, ValidationError, model_validator

from cdcsr.errors import CdcsrError
from cdcsr.robot.backbone import Backbone
from cdcsr.robot.parts import Joint, Link, Part, Positive, there
from cdcsr.robot.servo import Servo


class Path(Part):
    """The way of one cable along the arm. Distance from the axis and direction change linearly with
    the height from its first guide to its anchor."""

    later = ("pitch_radius", "end_pitch_radius", "twist_deg", "first_link", "last_link")
    angle_deg: float
    """Direction of its first guide around z, in degrees from x."""
    pitch_radius: Positive | None = None
    """Distance of its first guide from the axis in [m]; by default that of the segment's cables."""
    end_pitch_radius: Positive | None = None
    """Distance of its anchor from the axis in [m]; by default that of its first guide."""
    twist_deg: Annotated[float, Field(ge=-36000, le=36000)] = 0.0
    """Degrees by which it turns around the arm from its first guide to its anchor; a helix."""
    first_link: Annotated[int, Field(ge=0)] = 0
    """The first link whose joint it crosses, counted from 0 at the base. Below, a sheath that bends
    with the arm leads it, and it does not act on the arm there."""
    last_link: Annotated[int, Field(ge=0)] | None = None
    """The link that it ends on; by default the last one of its segment."""


class Cables(Part):
    """The cables that end at the top of one segment."""

    later = ("axial_stiffness", "guide_friction", "paths")
    angles_deg: Annotated[tuple[float, ...], Strict(False), Field(min_length=1)]
    """Direction of each cable around z, in degrees from x."""
    paths: Annotated[tuple[Path, ...], Strict(False)] = ()
    """In place of angles_deg: the cables one by one, where they are not straight and parallel."""
    pitch_radius: Positive
    """Distance of the cables from the arm's axis in [m]."""
    guide_offset: Positive
    """Distance of each guide from the nearer end of its link, in [m]; in the base, from the top
    face."""
    axial_stiffness: Positive | None = None
    """E A of a cable in [N]: it stretches by the tension times its rest length over E A. Without it
    cables do not stretch."""
    guide_friction: Annotated[float, Field(ge=0, le=2)] = 0.0
    """Coefficient of Coulomb friction between a cable and its guides; about 0.1 for steel in
    PTFE."""

    @model_validator(mode="before")
    @classmethod
    def _list_angles(cls, data: object) -> object:
        if not isinstance(data, Mapping) or "angles_deg" in data:
            return data
        paths = data.get("paths")
        if not isinstance(paths, list | tuple) or not all(isinstance(p, Mapping) for p in paths):
            return data
        return {**data, "angles_deg": [path.get("angle_deg") for path in paths]}

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.paths and self.angles_deg != tuple(path.angle_deg for path in self.paths):
            raise ValueError("angles_deg must be left out where paths list the cables")
        return self

    @property
    def ways(self) -> tuple[Path, ...]:
        """The way of each cable."""
        return self.paths or tuple(Path(angle_deg=angle) for angle in self.angles_deg)

    @property
    def widest(self) -> float:
        """The largest distance of a cable from the axis, in [m]."""
        radii = [(way.pitch_radius, way.end_pitch_radius) for way in self.ways]
        return max(self.pitch_radius, *(radius or 0.0 for pair in radii for radius in pair))


class Taper(Part):
    """How the links of a segment change from the first to the last, in between linearly."""

    later = ("radius", "mass")
    radius: Positive = 1.0
    """Radius of the last link as a multiple of the first's."""
    mass: Positive = 1.0
    """Mass of the last link as a multiple of the first's. The moments of inertia across a link grow
    with its mass, that along it with mass and radius squared."""


class OwnLink(Link):
    """One link of a segment whose links differ, with a joint of its own unless it has the
    segment's."""

    later = ("center", "mesh", "joint")
    joint: Joint | None = None

    @property
    def link(self) -> Link:
        """The link without its joint."""
        return Link(**{name: getattr(self, name) for name in Link.model_fields})


class Segment(Part):
    """A group of links and the cables that end on the last of them.

    Its links are equal and given by `link` and `joint`, or listed one by one as `chain`, or they
    are parts of a `backbone`. Without `cables` and `servo` the segment is passive.
    """

    later = ("link", "joint", "taper", "chain", "backbone", "coupling", "cables", "servo")
    links: Annotated[int, Field(ge=1)]
    """How many links it has; may be left out where `chain` lists them."""
    own_link: Link | None = Field(None, alias="link")
    own_joint: Joint | None = Field(None, alias="joint")
    taper: Taper | None = None
    """How radius and mass of `link` change along the segment."""
    own_chain: Annotated[tuple[OwnLink, ...], Strict(False)] = Field((), alias="chain")
    """The links one by one, from the base outwards."""
    backbone: Backbone | None = None
    coupling: Literal["equal-angles"] | None = None
    """equal-angles: linkage cables hold all bending hinges of the segment about one axis at one
    angle. Without it each joint bends by itself."""
    own_cables: Cables | None = Field(None, alias="cables")
    own_servo: Servo | None = Field(None, alias="servo")

    @model_validator(mode="before")
    @classmethod
    def _count_links(cls, data: object) -> object:
        if isinstance(data, Mapping) and "links" not in data:
            chain = data.get("chain")
            if isinstance(chain, list | tuple) and chain:
                return {**data, "links": len(chain)}
        return data

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if self.own_chain:
            self._check_chain()
        else:
            given = [part is not None for part in (self.own_link, self.own_joint, self.backbone)]
            if given not in ([True, True, False], [False, False, True]):
                raise ValueError("needs either link and joint, or backbone, or chain")
        if (self.own_cables is None) != (self.own_servo is None):
            raise ValueError("needs cables and servo, or neither")
        self._check_stretch()
        if self.taper is not None and self.own_link is None:
            raise ValueError("taper needs link; a backbone has end_radius, a chain lists its links")
        if self.taper is not None:
            self._check_taper()
        if self.backbone is not None:
            rest = max(abs(rate) for rate in (*self.backbone.curvature, self.backbone.twist))
            most = self.backbone.limit * self.links / self.backbone.length
            if rest > most:
                raise ValueError(
                    f"backbone's curvature and twist must be at most {most:g} rad/m, where its "
                    f"hinges reach their limit, not {rest:g}"
                )
        self._check_coupling()
        return self

    def _check_stretch(self) -> None:
        if self.own_cables is None or self.own_servo is None:
            return
        stiffness, pull = self.own_cables.axial_stiffness, self.own_servo.pull
        if stiffness is not None and stiffness < pull and self.own_servo.kind != "displacement":
            raise ValueError(
                f"cables.axial_stiffness must be at least the largest pull ({pull:g} N), under "
                "which a cable is twice as long as at rest"
            )

    def _check_coupling(self) -> None:
        if self.coupling is None:
            return
        for axis in "xy":
            hinges = [h for _, joint in self.pairs for h in joint.hinges if h.axis == axis]
            if len({hinge.rest for hinge in hinges}) > 1:
                raise ValueError(
                    f"coupling needs the same rest angle in all hinges about {axis}, because they "
                    "always have the same angle"
                )

    def _check_taper(self) -> None:
        """Check that every link is a rigid body: moments along and across an arm change
        differently."""
        try:
            _ = self.pairs
        except ValidationError as error:
            why = error.errors()[0]["msg"].removeprefix("Value error, ")
            raise ValueError(f"taper makes an impossible link: {why}") from None

    def _check_chain(self) -> None:
        if self.own_link is not None or self.backbone is not None:
            raise ValueError("needs one of link, backbone and chain")
        if self.links != len(self.own_chain):
            raise ValueError(f"links must be {len(self.own_chain)}, as many as chain lists")
        if self.own_joint is None and any(link.joint is None for link in self.own_chain):
            raise ValueError("needs a joint in each link of chain, or joint for all")

    @property
    def link(self) -> Link:
        """The first link of a segment that has no backbone."""
        return self._first[0]

    @property
    def joint(self) -> Joint:
        """The first joint of a segment that has no backbone."""
        return self._first[1]

    @property
    def _first(self) -> tuple[Link, Joint]:
        if self.backbone is not None:
            raise CdcsrError("This segment has no link or joint: they are given by its backbone.")
        return self.pairs[0]

    @property
    def cables(self) -> Cables:
        """The cables of a segment that is not passive."""
        return there(self.own_cables, "cables: it is passive")

    @property
    def servo(self) -> Servo:
        """The servo of each cable of a segment that is not passive."""
        return there(self.own_servo, "servo: it is passive")

    @property
    def cable_angles(self) -> tuple[float, ...]:
        """The direction of each of its cables around z, in degrees from x; none if passive."""
        return () if self.own_cables is None else self.own_cables.angles_deg

    @property
    def stub(self) -> Link | None:
        """The part below its first joint: half a cell of a backbone."""
        return self.backbone and self.backbone.piece(self.backbone.length / self.links / 2)

    @property
    def pairs(self) -> list[tuple[Link, Joint]]:
        """Its links with their joints, without the next segment's stub."""
        if self.own_chain:
            return [
                (link.link, link.joint or there(self.own_joint, "joint")) for link in self.own_chain
            ]
        if self.backbone is None:
            return self._equal_links
        cell = self.backbone.length / self.links
        lengths = [cell] * (self.links - 1) + [cell / 2]
        return [
            (self.backbone.piece(length, (n + 0.5) * cell), self.backbone.joint(self.links, n))
            for n, length in enumerate(lengths)
        ]

    @property
    def _equal_links(self) -> list[tuple[Link, Joint]]:
        link, joint = there(self.own_link, "link"), there(self.own_joint, "joint")
        if self.taper is None or self.links == 1:
            return [(link, joint)] * self.links
        along = [n / (self.links - 1) for n in range(self.links)]
        radius, mass = self.taper.radius - 1, self.taper.mass - 1
        return [(link.scaled(1 + radius * part, 1 + mass * part), joint) for part in along]
