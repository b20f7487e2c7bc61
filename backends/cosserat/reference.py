"""Shapes of continuous rods, solved by SoRoSim: the data of OpenCR-MuJoCo (arXiv 2606.22397).

The files' frame has the straight rod along +x; here it stands along +z of the base's frame, and
(x, y, z) of a file is (-z, -y, x) turned back: see :func:`_turned`. All is in SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array

_STATICS = "statics/{}RodMuJoCo_dataStatics.csv"
_RELEASES = "dynamics/{}RodMuJoCo_*.txt"
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
    """Of the middle and the tip, from the clamp, shape (n, 2, 3), in [m]."""


@dataclass(frozen=True)
class Release:
    """A rod that is held by wrenches and let go at time zero."""

    shape: Shapes
    """How it is held; one shape."""
    damping_time: float
    """Damping divided by stiffness, in [s]."""
    time: Array
    """Shape (steps,), in [s]."""
    place: Array
    """Of the middle and the tip, from the clamp, shape (steps, 2, 3), in [m]."""


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


def read_releases(folder: Path, material: str) -> list[Release]:
    """Read the releases of a material, in the order of the files' names.

    Raises:
        CdcsrError: an unknown material, or a file is missing or has another format.
    """
    paths = sorted(folder.glob(_RELEASES.format(_file_name(material))))
    if not paths:
        raise CdcsrError(f"There are no releases {_RELEASES.format('*')} in {folder}.")
    return [_read_release(path) for path in paths]


def _read_release(path: Path) -> Release:
    try:
        table = np.loadtxt(path)
        (damping, *_), held, rows = table[0], table[1], table[2:]
        gravity, middle, tip = table[0, 10:], held[1:7], held[7:13]
        place = np.stack([_turned(rows[:, 4:7]), _turned(rows[:, 10:13])], axis=1)
    except (OSError, ValueError, IndexError) as error:
        raise CdcsrError(f"Cannot read the release in {path}: {error}.") from None
    shape = Shapes(_turned(gravity)[None], _wrench(middle)[None], _wrench(tip)[None], place[:1])
    return Release(shape, float(damping), rows[:, 0], place)


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
