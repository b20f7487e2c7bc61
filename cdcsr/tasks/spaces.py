"""Operation spaces, where targets lie: the three of the BATD3 paper (Tian et al., section V-A), the
whole workspace of a robot, and the surface of debris in a mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.mesh_files import ENDINGS, is_mesh
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.arguments import as_floats
from cdcsr.tasks.debris import load_surface
from cdcsr.tasks.workspace_map import load_workspace

Array = NDArray[np.float64]

BALLS = ("floating", "spatter")
"""The spaces of balls around the demonstrations' targets."""
SPACES = ("anchor", *BALLS)
"""The spaces of the paper, which every robot has."""
WORKSPACE = "workspace"
"""The space of all targets that the demonstrator reaches; it needs a map of the workspace."""


class Space(Protocol):
    """A region of targets."""

    @property
    def name(self) -> str: ...

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        """Draw `num` targets, shape (num, 3), world frame, in [m]."""
        ...


@dataclass(frozen=True)
class Anchor:
    """A fixed cuboid: large debris, of which every part must be reached."""

    center: tuple[float, float, float]
    """World frame, in [m]."""
    size: tuple[float, float, float]
    """Edge lengths, in [m]."""
    name: str = "anchor"

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        return np.array(self.center) + (rng.random((num, 3)) - 0.5) * self.size


@dataclass(frozen=True)
class Balls:
    """Balls around the demonstrations' targets: debris that floats a little or has scattered."""

    name: str
    centers: Array
    """(n, 3), world frame, in [m]."""
    radius: float
    """[m]."""

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        center = self.centers[rng.integers(len(self.centers), size=num)]
        direction = rng.normal(size=(num, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        # The cube root makes the density uniform in the ball.
        return center + direction * self.radius * np.cbrt(rng.random((num, 1)))


@dataclass(frozen=True)
class WiderTargets:
    """A space and its surroundings, for training: half of its targets are moved out of place."""

    space: Space
    distance: float
    """The largest distance by which a target is moved, in [m]."""
    axes: tuple[bool, bool, bool] = (True, True, True)
    """The world axes along which targets are moved."""

    @property
    def name(self) -> str:
        return self.space.name

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        target = self.space.sample(rng, num)
        direction = rng.normal(size=(num, 3)) * self.axes
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        # The root makes the density uniform in the ball, or disc.
        far = self.distance * rng.random((num, 1)) ** (1 / sum(self.axes))
        return np.where(rng.random((num, 1)) < 0.5, target + far * direction, target)


def wider_targets(space: Space, distance: float, robot: Robot) -> WiderTargets:
    """Return a space widened by `distance` metres; in the plane of the workspace if that is flat.

    Args:
        space: where the targets of the task lie.
        distance: the largest distance by which a target is moved, in [m].
        robot: its workspace may be flat.
    """
    x, y, z = (extent > 0 for extent in robot.workspace.size)
    return WiderTargets(space, distance, (x, y, z) if x or y or z else (True, True, True))


def demonstration_targets(robot: Robot, num: int = 10, seed: int = 0) -> Array:
    """Draw the targets of demonstrations in the Anchor Space, shape (num, 3), in [m]."""
    return anchor(robot).sample(np.random.default_rng(seed), num)


def demonstration_space(name: str) -> str:
    """Return the space of the demonstrations from which a policy learns to work in space `name`.

    That is the Anchor Space, or the same space if it is the whole workspace or a file.
    """
    return name if name == WORKSPACE or name.endswith(".npz") or is_mesh(name) else "anchor"


def anchor(robot: Robot) -> Anchor:
    """Return the Anchor Space of a robot."""
    return Anchor(robot.workspace.center, robot.workspace.size)


def own_file(name: str, robot: Robot) -> dict[str, str]:
    """Return the digest of a file that the user gave as a space, as the entry of a record: `map` of
    a map, `debris` of a mesh; both of a mesh with a map.

    Another file may have the same name; the named spaces have no such entry.

    Raises:
        CdcsrError: there is no such file, or it is not for this robot.
    """
    if is_mesh(name):
        surface = load_surface(name, robot)
        own = surface.reach.map if surface.reach.given else None
        return {"debris": surface.digest} | ({} if own is None else {"map": own.digest})
    return {"map": load_workspace(robot, Path(name)).digest} if name.endswith(".npz") else {}


def make_space(name: str, robot: Robot, centers: Array | None = None) -> Space:
    """Return an operation space.

    Args:
        name: one of :data:`SPACES`, "workspace", the path of a map that ends in .npz, or that of a
            mesh that ends in .stl, .obj, .ply or .glb; `map.npz+mesh.stl` takes both.
        robot: whose workspace it is.
        centers: targets of the demonstrations, shape (n, 3), in [m]; by default those of seed 0.

    Raises:
        CdcsrError: there is no such space, or no map of the robot's workspace, or the arm does not
            reach the mesh.
    """
    if name == "anchor":
        return anchor(robot)
    if is_mesh(name):
        return load_surface(name, robot)
    if name == WORKSPACE or name.endswith(".npz"):
        return load_workspace(robot, None if name == WORKSPACE else Path(name))
    if name not in BALLS:
        raise CdcsrError(
            unknown_choice("space", name, (*SPACES, WORKSPACE))
            + f" Or give the path of a map (.npz) or of debris ({', '.join(ENDINGS)})."
        )
    if centers is None:
        centers = demonstration_targets(robot)
    own = ruler(robot)
    radius = own.floating if name == "floating" else own.spatter
    return Balls(name, as_floats("centers", centers, (-1, 3)), radius)
