"""Describe a new arm: one that is similar to that of the BATD3 paper, but of another size."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import parse_robot
from cdcsr.robot.ruler import rounded
from cdcsr.robot.stability import stable_step

_ARM, _PAPER_STEP, _BASE_DENSITY, _FALL = 2.4, 0.0025, 500 / 0.6**3, 9.81
"""Arm length and time step of the paper's robot in [m] and [s], density of its base in [kg/m^3],
and the acceleration of free fall on earth in [m/s^2]."""


@dataclass(frozen=True)
class NewRobot:
    """The choices from which a description follows.

    All numbers follow from those of the paper's robot by similarity: lengths in proportion, times
    with the square root of the length, so that accelerations stay, masses with its cube, forces
    too, and springs so that the arm keeps its shape. Links are solid cylinders. Under gravity the
    arm hangs from its base, and servos are as strong as its weight asks.

    Raises:
        CdcsrError: a number is out of bounds.
    """

    name: str
    length: float
    """The length of the arm, in [m]."""
    segments: int
    cables: int
    """The number in each segment."""
    links: int
    """The number in each segment."""
    base_mass: float | None = None
    """In [kg]; by default in proportion."""
    mount: str = "free"
    """free or fixed."""
    gravity: bool = False
    """Whether it hangs in gravity."""
    step: float | None = None
    """The time step in [s]; by default in proportion, or less where a spring asks it."""
    cuboid: float = 1.0
    """The edges of the Anchor Space, as a multiple of those in proportion."""
    spatter: float = 1.0
    """The radius of Spatter, as a multiple of the one in proportion."""

    def __post_init__(self) -> None:
        bounds: tuple[tuple[str, float | None, float, float], ...] = (
            ("length", self.length, 0.05, 100.0),
            ("segments", self.segments, 1, 16),
            ("cables", self.cables, 3, 12),
            ("links", self.links, 1, 100),
            ("base_mass", self.base_mass, 1e-6, 1e8),
        )
        for name, found, least, most in bounds:
            if found is not None and not least <= found <= most:
                raise CdcsrError(f"{name} must lie between {least:g} and {most:g}, not {found:g}.")

    @property
    def size(self) -> float:
        """Its length as a multiple of that of the paper's robot."""
        return self.length / _ARM

    @property
    def _link_length(self) -> float:
        return rounded(self.length / (self.segments * self.links), 6)

    @property
    def _link_mass(self) -> float:
        return _short(1.18 * 12 * self.size**3 / (self.segments * self.links))

    @property
    def _radius(self) -> float:
        return _short(0.02 * self.size)

    @property
    def _weight(self) -> float:
        """The weight of the arm on earth, in [N]."""
        return self._link_mass * self.segments * self.links * _FALL

    @property
    def _gain(self) -> float:
        """The gain of a servo, in [N/m]."""
        force = 250 * self.size**3
        if self.gravity:  # as much as holds the arm at the middle of the cuboid
            force = max(force, self._weight * 0.04 * self.length / self._radius)
        return _short(force / self._eta)

    @property
    def _eta(self) -> float:
        return _short(5 * self.size)

    def text(self) -> str:
        """Return the commented description in TOML.

        Raises:
            CdcsrError: the name is none that a robot can have, or numbers contradict each other.
        """
        if self.step is None:
            wanted = rounded(_PAPER_STEP * self.size**0.5, 2)
            drafted = parse_robot(replace(self, step=wanted).text(), self.name)
            step = min(wanted, rounded(0.95 * stable_step(drafted), 2))
            return replace(self, step=step).text()
        text = self._whole(self.step) + "".join(map(self._segment, range(self.segments)))
        parse_robot(text, self.name)
        return text

    def _whole(self, step: float) -> str:
        """Return all but the segments."""
        mass = _short(500 * self.size**3) if self.base_mass is None else self.base_mass
        edge = _short(max((mass / _BASE_DENSITY) ** (1 / 3), 0.25 * self.size))
        height = _short((-1 if self.gravity else 1) * (edge / 2 + (_ARM - 0.25) * self.size))
        center = f"{_short(0.2 * self.size):g}, {_short(0.1 * self.size):g}, {height:g}"
        size = ", ".join([f"{_short(0.2 * self.size * self.cuboid):g}"] * 3)
        inertia = ", ".join([f"{mass * edge**2 / 6:.4g}"] * 3)
        scale = ""
        if self.spatter != 1:
            whole = 0.15 * self.size
            scale = f"""
# The radius of Spatter. With {_short(whole):g} m, in proportion, the demonstrator would miss
# more than 5 % of the targets.
[scale]
spatter = {_short(whole * self.spatter):g}
"""
        fall = f"gravity = [0.0, 0.0, -{_FALL}]\n" if self.gravity else ""
        more = "" if self.mount == "free" else f'mount = "{self.mount}"\n'
        if self.gravity:
            more += "# Half a turn about x: the arm hangs.\nquaternion = [0.0, 1.0, 0.0, 0.0]\n"
        return f"""\
# An arm of {self.length:g} m like the paper's: {self.segments} segments of {self.links} links,
# with {self.cables} cables each. Replace its numbers by those of your drawing. All are in SI units.
name = "{self.name}"
# Springs are stable up to this step.
time_step = {step:g}
{fall}
# The arm begins in the middle of the top face.
[base]
size = [{edge:g}, {edge:g}, {edge:g}]
mass = {mass:g}
inertia = [{inertia}]
{more}
# An excess of cable length or of a hinge's angle decays with this time constant.
[constraint]
recovery_time = {2 * step:.4g}

# The cuboid in which targets lie, in the world frame.
[workspace]
center = [{center}]
size = [{size}]
{scale}"""

    def _segment(self, number: int) -> str:
        """Return one segment, counted from the base."""
        cell, mass, radius = self._link_length, self._link_mass, self._radius
        across, along = mass * (3 * radius**2 + cell**2) / 12, mass * radius**2 / 2
        stiffness = _short(0.4 * self.size**5 / cell)
        turn = 360 / self.cables * number / self.segments
        angles = (rounded(turn + 360 * k / self.cables, 6) for k in range(self.cables))
        pull = self._gain * self._eta
        return f"""
# Segment {number + 1} of {self.segments}, counted from the base.
[[segments]]
links = {self.links}

# One link: a solid cylinder with its joint at the lower end.
[segments.link]
length = {cell:g}
radius = {radius:g}
mass = {mass:g}
inertia = [{across:.4g}, {across:.4g}, {along:.4g}]

# Each of its two hinges. In balance, one cable that is pulled in full would bend a hinge by
# {pull * radius / stiffness:.2g} rad; the arm weighs {self._weight:.3g} N on earth.
[segments.joint]
stiffness = {stiffness:g}
damping = {_short(stiffness * 0.525 * self.size**0.5):g}
limit = 1.5

# Where the cables that end here run: degrees around the arm, and distance from its axis.
[segments.cables]
angles_deg = [{", ".join(f"{angle:g}" for angle in angles)}]
pitch_radius = {radius:g}
guide_offset = {_short(min(0.02 * self.size, 0.2 * cell)):g}

# The servo of each cable pulls with up to gain * eta = {pull:.3g} N.
[segments.servo]
mass = {_short(0.2 * self.size**3):g}
damping = {_short(20 * self.size**2.5):g}
gain = {self._gain:g}
eta = {self._eta:g}
radius = {_short(0.01 * self.size):g}
offset = {_short(0.2 * self.size):g}
"""


def _short(number: float) -> float:
    return rounded(number, 4)
