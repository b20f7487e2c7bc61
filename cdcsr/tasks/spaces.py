"""Operation spaces: where targets lie. The three of the BATD3 paper (Tian et al., section V-A), and all around."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.tasks.workspace_map import load_workspace

Array = NDArray[np.float64]

RADIUS = {"floating": 0.01, "spatter": 0.15}
"""How far targets lie from the demonstrations' targets, xi_F and xi_S in [m]."""
SPACES = ("anchor", *RADIUS)
"""Those of the paper, which every robot has."""
WORKSPACE = "workspace"
"""All that the demonstrator reaches, for a robot of which there is a map."""


class Space(Protocol):
    """A region of targets."""

    @property
    def name(self) -> str: ...

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        """`num` targets, shape (num, 3), world frame, in [m]."""
        ...


@dataclass(frozen=True)
class Anchor:
    """A fixed cuboid: large debris, all of whose parts must be reached."""

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    name: str = "anchor"

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        return np.array(self.center) + (rng.random((num, 3)) - 0.5) * self.size


@dataclass(frozen=True)
class Around:
    """Balls around the demonstrations' targets: debris that floats a little, or has scattered."""

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
class Beyond:
    """A space and what lies around it, for practice: half of its targets are moved from where the space has them."""

    space: Space
    distance: float
    """How far they are moved at most, in [m]."""
    axes: tuple[bool, bool, bool] = (True, True, True)
    """World axes along which they may be; for an arm in a plane, those of the plane."""

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


def beyond(space: Space, distance: float, robot: Robot) -> Beyond:
    """What lies around a space of a robot; of one whose workspace is flat, in that plane.

    Args:
        space: where targets of the task lie.
        distance: how far around it, in [m].
        robot: whose workspace it is.
    """
    x, y, z = (extent > 0 for extent in robot.workspace.size)
    return Beyond(space, distance, (x, y, z) if x or y or z else (True, True, True))


def demonstration_targets(robot: Robot, num: int = 10, seed: int = 0) -> Array:
    """The targets of demonstrations, shape (num, 3): drawn in the Anchor Space."""
    return anchor(robot).sample(np.random.default_rng(seed), num)


def demonstration_space(name: str) -> str:
    """Where the demonstrations for learning in a space are taken: in the Anchor Space, or all around in a workspace."""
    return name if name == WORKSPACE or name.endswith(".npz") else "anchor"


def anchor(robot: Robot) -> Anchor:
    """The Anchor Space of a robot."""
    return Anchor(robot.workspace.center, robot.workspace.size)


def make_space(name: str, robot: Robot, centers: Array | None = None) -> Space:
    """The operation space of that name.

    Args:
        name: one of :data:`SPACES`, "workspace", or the path of a map of a workspace, which ends in .npz.
        robot: whose workspace it is.
        centers: targets of the demonstrations, shape (n, 3); by default those of seed 0.

    Raises:
        CdcsrError: there is no such space, or no map of the robot's workspace.
    """
    if name == "anchor":
        return anchor(robot)
    if name == WORKSPACE or name.endswith(".npz"):
        return load_workspace(robot, None if name == WORKSPACE else Path(name))
    if name not in RADIUS:
        raise CdcsrError(unknown_choice("space", name, (*SPACES, WORKSPACE)))
    if centers is None:
        centers = demonstration_targets(robot)
    return Around(name, np.asarray(centers, dtype=float), RADIUS[name])
