"""Elastic rods as robots, and the files of a public set of continuous ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.optimize import bisect
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array

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
LENGTH, STIFFNESS, DENSITY = 0.4, 70e6 * np.pi * 0.005**4 / 4, 1200 * np.pi * 0.005**2
"""TPU: [m], [N m^2] and [kg/m]."""
DIRECTION = np.array([0.6, 0.8])
"""Tips bend towards it, across the straight rod."""


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


def file_vector(across: float, along: float) -> Array:
    """Return a vector in the frame of the files, where the rod lies along x; ours is half a turn
    away, about the line between x and z."""
    x, y = across * DIRECTION
    return np.array([along, -y, x])


def write_shapes(folder: Path, forces: list[float]) -> None:
    """Write rods under tip forces across them, as the elastica has them."""
    tables = np.zeros((len(forces), 6, 17))
    for table, force in zip(tables, forces, strict=True):
        table[3:, 2] = file_vector(force, 0.0)
        table[3:, 16] = file_vector(*elastica(force, LENGTH, STIFFNESS))
    write_tables(folder, tables)


def write_tables(folder: Path, tables: Array) -> None:
    """Write shapes at rest, each as three rows of angles and three of positions, shape (n, 6, 17):
    gravity, the wrenches at the middle and at the tip, and at 9 and 16 the poses of both."""
    rows = [["label"] * 18] * 2
    rows += [["row", *map(repr, line)] for line in tables.reshape(-1, 17).tolist()]
    path = folder / "statics" / "TPURodMuJoCo_dataStatics.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(",".join(row) for row in rows))
