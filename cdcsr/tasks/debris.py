"""Debris as a mesh: targets lie on its surface, as far as the arm reaches it."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import note
from cdcsr.reading import digest
from cdcsr.robot.description import Robot
from cdcsr.robot.mesh_files import read_mesh
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.rotations import at_start, rotation_matrix
from cdcsr.tasks.workspace_map import Workspace, load_workspace

Array = NDArray[np.float64]

_TRIED = 20_000
"""How many points of the surface tell what share of it is in reach."""
_LEAST_SHARE = 1e-3
_WITH_MAP = ".npz+"
"""In a name, after a map of the workspace and before a mesh."""


@dataclass(frozen=True)
class Reach:
    """The places that the tip of a robot may reach: all within the arm's length of the first joint
    and outside of the base, or all in a map of the workspace."""

    robot: Robot
    map: Workspace | None = None
    given: bool = False
    """Whether the map is one that the user named."""

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Return which points are in reach, shape (n,).

        Args:
            points: shape (n, 3), world frame, in [m].
        """
        if self.map is not None:
            return self.map.holds(points)
        robot = self.robot
        joint = at_start(robot, [0.0, 0.0, robot.first_joint])
        length = robot.top + robot.arm_length - robot.first_joint
        near = np.linalg.norm(points - joint, axis=1) <= length
        turn = rotation_matrix(np.array([robot.base.quaternion]))[0]
        inside = np.abs((points - robot.base.position) @ turn) <= np.array(robot.base.size) / 2
        return near & ~inside.all(axis=1)

    @property
    def title(self) -> str:
        """How a message names it."""
        if self.map is not None:
            return f"in the map of the workspace of {self.robot.name!r}"
        return f"within the arm's length of the first joint of {self.robot.name!r}"


@dataclass(frozen=True)
class Surface:
    """The surface of a piece of debris; targets are uniform by area on the part in reach."""

    name: str
    vertices: Array
    """Shape (n, 3), world frame, in [m]."""
    faces: NDArray[np.int64]
    """The vertices of each triangle, shape (m, 3)."""
    reach: Reach

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of the mesh's content."""
        arrays = self.vertices.astype(float), self.faces.astype(np.int64)
        return digest(b"".join(array.tobytes() for array in arrays))

    @cached_property
    def share(self) -> float:
        """The share of the surface that is in reach, as an estimate from many points."""
        return float(self.reach.holds(self.spread(np.random.default_rng(0), _TRIED)).mean())

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        found = np.zeros((0, 3))
        while len(found) < num:
            points = self.spread(rng, math.ceil((num - len(found)) / max(self.share, 1 / _TRIED)))
            found = np.concatenate([found, points[self.reach.holds(points)]])
        return found[:num]

    def spread(self, rng: np.random.Generator, num: int) -> Array:
        """Draw `num` points of the whole surface, shape (num, 3), in reach or not."""
        chosen = np.searchsorted(self._areas, rng.random(num) * self._areas[-1], side="right")
        # Uniform in a parallelogram; its other half is folded onto the triangle.
        along = rng.random((num, 2, 1))
        along = np.where(along.sum(axis=1, keepdims=True) > 1, 1 - along, along)
        corners = self.vertices[self.faces[chosen]]
        return corners[:, 0] + (along * (corners[:, 1:] - corners[:, :1])).sum(axis=1)

    @cached_property
    def _areas(self) -> Array:
        """Twice the area of all triangles up to each one, shape (m,), in [m^2]."""
        corners = self.vertices[self.faces]
        sides = corners[:, 1:] - corners[:, :1]
        return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).cumsum()


def load_surface(name: str, robot: Robot) -> Surface:
    """Load debris from a mesh file whose coordinates are in the world frame, in [m].

    In reach is what the given map of the robot's workspace holds, else the shipped one; a robot
    without one, or with a flat one, may reach whatever is within its arm's length. A note says what
    share that is.

    Args:
        name: the path of the mesh, or `map.npz+mesh.stl` for a map of one's own.
        robot: whose arm is to reach it.

    Raises:
        CdcsrError: it is no usable mesh, is hardly as large as the threshold, or the arm reaches
            less than a thousandth of it. The map is none of this robot, or a flat one.
    """
    path, reach = Path(name), Reach(robot)
    if _WITH_MAP in name:
        own, _, rest = name.partition(_WITH_MAP)
        path, reach = Path(rest), Reach(robot, load_workspace(robot, Path(f"{own}.npz")), True)
        if reach.map is not None and not reach.map.edges.all():
            raise CdcsrError(f"The map {own}.npz is flat, and no debris is; leave it out.")
    else:
        with suppress(CdcsrError):  # there is none
            shipped = load_workspace(robot)
            reach = Reach(robot, shipped) if shipped.edges.all() else reach
    mesh = read_mesh(path, "debris")
    surface = Surface(name, np.array(mesh.vertices), np.array(mesh.faces), reach)
    if max(mesh.extents) < ruler(robot).threshold:
        raise CdcsrError(
            f"The debris {path} is {max(mesh.extents):.3g} m large, less than the threshold of "
            f"{ruler(robot).threshold:g} m within which its targets are reached. Coordinates are "
            "read as metres: export it in metres."
        )
    if surface.share < _LEAST_SHARE:
        raise CdcsrError(
            f"Less than {_LEAST_SHARE:.1%} of the debris {path} is {reach.title}: it extends from "
            f"{_place(mesh.bounds[0])} to {_place(mesh.bounds[1])}. {_remedy(surface)}"
        )
    if surface.share < 1:
        note(f"Targets lie on {surface.share:.0%} of the debris {path}: what is {reach.title}.")
    return surface


def _remedy(surface: Surface) -> str:
    """Return what to do about debris that is out of reach."""
    center = surface.reach.robot.workspace.center
    if replace(surface, vertices=surface.vertices / 1e3).share > _LEAST_SHARE:
        return (
            "Coordinates are read as metres, and these look like millimetres: export it in metres."
        )
    return (
        f"Coordinates are read as metres in the world frame; move it near {_place(center)}, the "
        "middle of the robot's workspace."
    )


def _place(point: Array | tuple[float, ...]) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)}) m"
