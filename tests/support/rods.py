"""Elastic rods as robots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import bisect
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

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


def elastica(force: float, length: float, stiffness: float) -> tuple[float, float]:
    """Return the tip of a clamped rod under a force across it: across and along, in [m].

    K. E. Bisshopp and D. C. Drucker, "Large deflection of cantilever beams", Quarterly of Applied
    Mathematics 3 (1945): with the tip's slope a, k^2 = (1 + sin a) / 2 and sin f = 1 / (k sqrt 2),
    sqrt(P L^2 / E I) = K(k) - F(f, k). The force is in [N], the stiffness E I in [N m^2].
    """
    load = np.sqrt(force * length**2 / stiffness)

    def integrals(slope: float) -> tuple[float, float]:
        m = (1 + np.sin(slope)) / 2
        f = np.arcsin(1 / np.sqrt(2 * m))
        return ellipk(m) - ellipkinc(f, m), ellipe(m) - ellipeinc(f, m)

    slope = bisect(lambda s: integrals(s)[0] - load, 1e-9, np.pi / 2 - 1e-9, xtol=1e-14)
    assert isinstance(slope, float)
    across = length * (1 - 2 * integrals(slope)[1] / load)
    return across, np.sqrt(2 * stiffness * np.sin(slope) / force)
