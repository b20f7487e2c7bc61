"""Draw what the lengths of a description mean: `python docs/geometry.py FILE.svg`.

Everything is placed by a description; only its proportions are wider than those of a real arm.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

from cdcsr.plots import COLORS, INK, SOFT, drawn
from cdcsr.robot.description import Robot, load_robot, parse_robot
from cdcsr.robot.meshes import segment_color
from cdcsr.robot.routing import routing

_WIDE = {"link": {"radius": 0.03}, "cables": {"pitch_radius": 0.055, "guide_offset": 0.035}}
_SERVO = {"offset": 0.09, "radius": 0.016}


def wide_robot() -> Robot:
    """Return a robot of two segments of two links, wide enough that its parts can be told apart."""
    paper = load_robot("paper")
    parts = []
    for segment in paper.segments:
        link = segment.link.model_copy(update=_WIDE["link"])
        cables = segment.cables.model_copy(update=_WIDE["cables"])
        servo = segment.servo.model_copy(update=_SERVO)
        update = {"links": 2, "own_link": link, "own_cables": cables, "own_servo": servo}
        parts.append(segment.model_copy(update=update))
    base = paper.base.model_copy(update={"size": (0.4, 0.4, 0.4)})
    return parse_robot(
        paper.model_copy(update={"name": "drawn", "base": base, "segments": tuple(parts)}).to_toml()
    )


def draw_geometry(robot: Robot, path: Path) -> None:
    """Draw a robot from the side and its cables seen from the tip.

    Args:
        robot: two segments of equal links with parallel cables.
        path: the file to write.
    """
    with drawn(path, (9.6, 8.2)) as figure:
        side = figure.add_axes((0.0, 0.0, 0.66, 1.0))
        _draw_side(side, robot)
        above = figure.add_axes((0.68, 0.4, 0.32, 0.4))
        _draw_section(above, robot)
        for axes in (side, above):
            axes.set_aspect("equal")
            axes.set_axis_off()


def _draw_side(axes: Axes, robot: Robot) -> None:
    """Draw base, links, guides, sliders and the cables that lie in the plane of x and z."""
    width, _, high = robot.base.size
    corner = (-width / 2, -high / 2)
    axes.add_patch(Rectangle(corner, width, high, fc="#eef0f4", ec=SOFT, lw=1.2))
    route, heights = (
        routing(robot),
        robot.first_joint + np.cumsum([0.0, *(link.length for link, _ in robot.links)]),
    )
    segments = [s for s, segment in enumerate(robot.segments) for _ in range(segment.links)]
    for (link, _), low, s in zip(robot.links, heights, segments, strict=False):
        color = np.array(segment_color(s)[:3]) / 255
        body = Rectangle((-link.radius, low), 2 * link.radius, link.length, fc=color, alpha=0.35)
        axes.add_patch(body)
        axes.add_patch(Circle((0, low), 0.012, fc="white", ec=INK, lw=1.2, zorder=4))
    axes.plot(0, heights[-1], marker="*", ms=12, color=COLORS[4], zorder=5)
    feet = [0.0, *heights[:-1]]
    for c, place in enumerate(route.place):
        owner = next(s for s in range(robot.num_segments) if c < 4 * (s + 1))
        color = np.array(segment_color(owner)[:3]) / 255 * 0.8
        if abs(place[1]) > abs(place[0]):
            continue  # it lies in front of the axis
        points = [(g.place[0], g.place[2] + feet[g.body]) for g in route.guides[c]]
        slider = (place[0], points[0][1] - robot.servos[c].offset)
        for (x, low), (u, top) in pairwise([slider, *points]):
            axes.plot([x, u], [low, top], color=color, lw=1.4, zorder=3)
        axes.add_patch(Circle(slider, robot.servos[c].radius, fc=color, zorder=4))
        xs, zs = np.array(points).T
        axes.plot(xs, zs, "s", ms=4.5, mfc="white", mec=color, zorder=4)
    _name_lengths(axes, robot, heights)


def _name_lengths(axes: Axes, robot: Robot, heights: np.ndarray) -> None:
    """Put the names of the fields beside what they measure."""
    width, _, high = robot.base.size
    segment, top = robot.segments[0], robot.top
    pitch, offset = segment.cables.pitch_radius, segment.cables.guide_offset
    radius, servo = segment.link.radius, segment.servo
    guide = top - offset
    _span(axes, (-width / 2, -high / 2 - 0.03), (width / 2, -high / 2 - 0.03), "base.size[0]", "c")
    _span(
        axes, (width / 2 + 0.03, -high / 2), (width / 2 + 0.03, high / 2), "base.size[2]", "l", 0.03
    )
    _span(axes, (-0.16, heights[1]), (-0.16, heights[2]), "link.length", "r")
    z = heights[1] + 0.1
    _span(axes, (0, z), (radius, z), "link.radius", "l", gap=0.06)
    z = heights[3] - offset - 0.05
    _span(axes, (0, z), (pitch, z), "cables.pitch_radius", "l", gap=0.03)
    for low, end, text in (
        (heights[0], heights[0] + offset, "cables.guide_offset"),
        (guide, top, ""),
    ):
        _span(axes, (pitch + 0.05, low), (pitch + 0.05, end), text, "l")
    _span(axes, (-pitch - 0.05, guide - servo.offset), (-pitch - 0.05, guide), "servo.offset", "r")
    notes = {
        "slider, a ball of servo.radius": ((pitch, guide - servo.offset), (0.24, 0.09)),
        "guide": ((pitch / 2**0.5, heights[2] + offset), (0.2, heights[2] + offset)),
        "joint: hinges about x and y": ((0, heights[3]), (0.2, heights[3])),
        "anchor of segment 1": ((pitch, heights[2] - offset), (0.2, heights[2] - offset)),
        "tip": ((0, heights[-1]), (0.2, heights[-1] + 0.03)),
        "origin: the base's centre": ((0, 0), (-0.24, -0.09)),
    }
    for text, (place, label) in notes.items():
        side = "right" if label[0] < 0 else "left"
        arrow = {"arrowstyle": "-", "color": SOFT, "lw": 0.9}
        axes.annotate(text, place, label, ha=side, va="center", fontsize=9, arrowprops=arrow)
    for axis, end in (("x", (0.09, 0.0)), ("z", (0.0, 0.09))):
        axes.add_patch(FancyArrowPatch((0, 0), end, arrowstyle="-|>", mutation_scale=10, color=INK))
        axes.text(end[0] + 0.012, end[1] + 0.005, axis, fontsize=9)
    axes.set_xlim(-0.62, 0.72)
    axes.set_ylim(-high / 2 - 0.08, heights[-1] + 0.06)


def _span(
    axes: Axes,
    low: tuple[float, float],
    high: tuple[float, float],
    text: str,
    side: str,
    gap: float = 0.015,
) -> None:
    """Draw an arrow from end to end, and its name left (r), right (l) or below (c) of it."""
    arrow = {"arrowstyle": "<->", "color": INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", low, high, arrowprops=arrow)
    (x, z), (u, w) = low, high
    place = {"r": (min(x, u) - gap, (z + w) / 2), "l": (max(x, u) + gap, (z + w) / 2)}
    where = place.get(side, ((x + u) / 2, z - 0.03))
    how = {"r": "right", "l": "left", "c": "center"}[side]
    axes.text(*where, text, ha=how, va="center", fontsize=9, family="monospace")


def _draw_section(axes: Axes, robot: Robot) -> None:
    """Draw the cables seen from the tip, with their directions."""
    axes.set_title("seen from the tip: cables.angles_deg")
    axes.add_patch(Circle((0, 0), robot.segments[0].link.radius, fc="#eef0f4", ec=SOFT))
    pitch = robot.segments[0].cables.pitch_radius
    axes.add_patch(Circle((0, 0), pitch, fill=False, ec=SOFT, ls=":"))
    for s, segment in enumerate(robot.segments):
        color = np.array(segment_color(s)[:3]) / 255 * 0.8
        for angle in segment.cables.angles_deg:
            turn = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
            axes.plot(*(pitch * turn), "o", ms=7, color=color)
            axes.text(*(1.3 * pitch * turn), f"{angle:g}°", ha="center", va="center", fontsize=8)
        axes.plot([], [], "o", color=color, label=f"segment {s + 1}")
    for name, end in (("x", (1.75 * pitch, 0)), ("y", (0, 1.75 * pitch))):
        start = (0.85 * end[0], 0.85 * end[1])
        axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=9, color=INK))
        axes.text(end[0] + 0.004, end[1] + 0.004, name, fontsize=9)
    axes.set_xlim(-1.8 * pitch, 2.0 * pitch)
    axes.set_ylim(-1.8 * pitch, 2.0 * pitch)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.12), ncols=2, fontsize=8.5)


if __name__ == "__main__":
    draw_geometry(wide_robot(), Path(sys.argv[1]))
