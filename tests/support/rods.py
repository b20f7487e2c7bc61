"""Elastic rods as robots."""

from __future__ import annotations

from collections.abc import Mapping

from cdcsr.robot.description import Robot

CABLES: dict[str, dict[str, object]] = {
    "cables": {"angles_deg": (0.0, 120.0, 240.0), "pitch_radius": 0.01, "guide_offset": 0.002},
    "servo": {
        "mass": 0.05,
        "damping": 20.0,
        "gain": 200.0,
        "eta": 0.5,
        "radius": 0.005,
        "offset": 0.05,
    },
}
"""Sections that give a segment three cables."""


def rod_robot(
    links: int,
    *backbones: Mapping[str, object],
    parts: Mapping[str, object] | None = None,
    **keys: object,
) -> Robot:
    """Return a clamped arm with one segment of `links` links for each backbone.

    Args:
        links: the number of links of each segment.
        backbones: their materials.
        parts: more sections of each segment, such as :data:`CABLES`.
        keys: top-level keys to set.
    """
    base = {"size": (0.1, 0.1, 0.1), "mass": 1.0, "inertia": (0.001, 0.001, 0.001)}
    segments = [{"links": links, "backbone": b, **(parts or {})} for b in backbones]
    return Robot.model_validate(
        {
            "name": "rod",
            "time_step": 0.001,
            "base": base | {"mount": "fixed"},
            "constraint": {"recovery_time": 0.002},
            "workspace": {"center": (0.0, 0.0, 0.5), "size": (0.1, 0.1, 0.1)},
            "segments": segments,
        }
        | keys
    )
