"""The colours of a robot and of marks, and which links look alike, in pictures by every engine and
in model files."""

from __future__ import annotations

from cdcsr.robot.description import Robot

Color = tuple[int, int, int, int]
"""Red, green, blue and opacity, each from 0 to 255."""
HULL: Color = (190, 195, 205, 255)
PANEL: Color = (35, 60, 130, 255)
METAL: Color = (90, 90, 95, 255)
_SEGMENTS: tuple[Color, ...] = ((225, 120, 50, 255), (60, 140, 200, 255), (90, 170, 90, 255))
DEBRIS: Color = (150, 140, 125, 255)
TARGET: Color = (235, 45, 60, 255)
TIP: Color = (25, 160, 70, 255)
CABLE: Color = (60, 60, 66, 255)
BACKGROUND = (246, 247, 250)
TARGET_RADIUS, TIP_RADIUS = 0.018, 0.010
"""The radii of the marks of an arm of 2.4 m, in [m]."""
CABLE_RADIUS = 0.002
"""That of the drawn cables, in [m]."""


def segment_color(segment: int) -> Color:
    """Return the colour of a segment's links, counted from the base; a fourth has the first's."""
    return _SEGMENTS[segment % len(_SEGMENTS)]


def share(color: Color) -> tuple[float, float, float, float]:
    """Return a colour with components from 0 to 1."""
    red, green, blue, opacity = (part / 255 for part in color)
    return red, green, blue, opacity


def link_parts(robot: Robot) -> list[str]:
    """Return the name of each link's mesh, from the base to the tip."""
    parts: list[str] = []
    for s, segment in enumerate(robot.segments):
        links = [link for link, _ in robot.links[len(parts) : len(parts) + segment.links]]
        names = [f"link_{s}_{n}" for n in range(len(links) - 1)] + [f"end_{s}"]
        parts += [f"link_{s}" if a == links[0] else b for a, b in zip(links, names, strict=True)]
    return parts
