"""Shapes of continuous rods, solved by SoRoSim: the data of OpenCR-MuJoCo (arXiv 2606.22397).

The files' frame has the straight rod along +x; here it stands along +z of the base's frame: see
:func:`_turned`. All is in SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array

_STATICS = "statics/{}RodMuJoCo_dataStatics.csv"
_DYNAMICS = "dynamics/{}RodMuJoCo_{}.txt"
_FILE_NAMES = {"steel": "SpringSteel", "tpu": "TPU"}
_RODS = {
    "steel": {
        "youngs_modulus": 200e9,
        "poissons_ratio": 0.33,
        "density": 7870.0,
        "radius": 0.0008,
        "length": 0.6,
    },
    "tpu": {
        "youngs_modulus": 70e6,
        "poissons_ratio": 0.4,
        "density": 1200.0,
        "radius": 0.005,
        "length": 0.4,
    },
}
MATERIALS = tuple(_RODS)


@dataclass(frozen=True)
class Shapes:
    """Rods at rest under gravity and two wrenches that are fixed in the world; n shapes."""

    gravity: Array
    """Shape (n, 3), in [m/s^2]."""
    middle: Array
    """Torque in [N m] and force in [N] at half of the length, shape (n, 6)."""
    tip: Array
    """Torque in [N m] and force in [N] at the tip, shape (n, 6)."""
    place: Array
    """Places of the middle and the tip, from the clamp, shape (n, 2, 3), in [m]."""


@dataclass(frozen=True)
class Release:
    """A rod that rests under wrenches and gravity, and is let go of the wrenches at once."""

    damping_time: float
    """Damping divided by stiffness, in [s]."""
    gravity: Array
    """Shape (3,), in [m/s^2]."""
    wrenches: tuple[Array, Array]
    """Torque in [N m] and force in [N] that held its middle and its tip, each of shape (6,)."""
    interval: float
    """The time between two places of the tip, in [s]."""
    tip: Array
    """Places of the tip from the clamp, shape (T, 3), in [m]; the first is at rest."""


def rod(material: str, links: int, damping_time: float = 0.004, time_step: float = 1e-3) -> Robot:
    """Return a rod of the data as a robot: clamped, without cables and without gravity.

    Gravity differs between shapes, so :func:`backends.cosserat.statics.load` applies it.
    """
    step = {"time_step": time_step, "constraint": {"recovery_time": 2 * time_step}}
    base = {"size": (0.1, 0.1, 0.1), "mass": 1.0, "inertia": (0.001, 0.001, 0.001)}
    backbone = _RODS[material] | {"damping_time": damping_time}
    workspace = {"center": (0.0, 0.0, 0.5), "size": (0.1, 0.1, 0.1)}
    return Robot.model_validate(
        step
        | {"name": f"rod-{material}", "base": base | {"mount": "fixed"}, "workspace": workspace}
        | {"segments": [{"links": links, "backbone": backbone}]}
    )


def stacked_rod(
    material: str, links: int, damping_time: float = 0.004, time_step: float = 1e-3
) -> Robot:
    """Return the rod as a plain stack of equal links, with a joint at the beginning of each.

    This is the plain way to build a chain. Each joint has the stiffness of its whole cell, but sits
    half a cell too low.
    """
    whole = rod(material, links, damping_time, time_step)
    backbone = whole.segments[0].backbone
    assert backbone is not None
    joint = backbone.joint(links, 0).model_dump()
    piece = backbone.piece(backbone.length / links).model_dump()
    segments = [{"links": links, "link": piece, "joint": joint}]
    return Robot.model_validate(whole.model_dump() | {"segments": segments})


def read_release(folder: Path, material: str, number: int) -> Release:
    """Read a release of a material.

    Args:
        folder: the data.
        material: the rod's.
        number: of the file, from 1.

    Raises:
        CdcsrError: an unknown material, or the file is missing or has another format.
    """
    path = folder / _DYNAMICS.format(_file_name(material), number)
    try:
        table = np.loadtxt(path, delimiter="\t", ndmin=2)
    except (OSError, ValueError) as error:
        raise CdcsrError(f"Cannot read the release in {path}: {error}.") from None
    if table.shape[0] < 4 or table.shape[1] != 13 or not np.isfinite(table).all():
        raise CdcsrError(
            f"The file {path} is no release: it needs 13 columns of numbers, and two rows of loads "
            f"before at least two of motion; found {table.shape[1]} columns and {len(table)} rows."
        )
    wrenches = _wrench(table[1, 1:7]), _wrench(table[1, 7:13])
    interval, tip = float(table[3, 0] - table[2, 0]), _turned(table[2:, 10:13])
    return Release(float(table[0, 0]), _turned(table[0, 10:13]), wrenches, interval, tip)


def count_releases(folder: Path, material: str) -> int:
    """Return how many releases of a material a folder holds; they are numbered from 1."""
    number = 0
    while (folder / _DYNAMICS.format(_file_name(material), number + 1)).is_file():
        number += 1
    return number


def read_shapes(folder: Path, material: str) -> Shapes:
    """Read the shapes at rest of a material.

    Raises:
        CdcsrError: an unknown material, or a file is missing or has another format.
    """
    path = folder / _STATICS.format(_file_name(material))
    try:
        table = np.genfromtxt(path, delimiter=",", skip_header=2)[:, 1:18]
        rows = table.reshape(-1, 6, 17)  # six rows a shape: three angles, three positions
    except (OSError, ValueError, IndexError) as error:
        raise CdcsrError(f"Cannot read the shapes in {path}: {error}.") from None
    if not np.isfinite(rows).all():
        raise CdcsrError(f"The file {path} holds what is not a number.")
    gravity, middle, tip = (_wrench(rows[:, :, column]) for column in range(3))
    place = np.stack([_turned(rows[:, 3:, column]) for column in (9, 16)], axis=1)
    return Shapes(gravity[:, 3:], middle, tip, place)


def first(shapes: Shapes, num: int) -> Shapes:
    """Return the first `num` shapes."""
    return Shapes(shapes.gravity[:num], shapes.middle[:num], shapes.tip[:num], shapes.place[:num])


def _wrench(values: Array) -> Array:
    """Turn torque and force, shape (..., 6), from the files' frame."""
    return np.concatenate([_turned(values[..., :3]), _turned(values[..., 3:])], axis=-1)


def _turned(vector: Array) -> Array:
    """Turn vectors, shape (..., 3), from the files' frame, in which the rod lies along x, to the
    base's frame, in which it stands along z: a half-turn about the line between both axes."""
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack([z, -y, x], axis=-1)


def _file_name(material: str) -> str:
    if material not in _FILE_NAMES:
        raise CdcsrError(unknown_choice("material", material, MATERIALS))
    return _FILE_NAMES[material]
