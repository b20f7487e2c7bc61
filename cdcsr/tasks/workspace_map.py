"""Maps of a robot's whole workspace: all targets that the demonstrator reaches.

A map is a set of cells of a grid. A cell belongs to it if the demonstrator reaches every corner of
the cell in time. `cdcsr workspace` computes a map.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import write_bytes
from cdcsr.robot.description import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Workspace:
    """Cells of a grid; targets are uniform in their union."""

    robot: str
    """The fingerprint of the robot."""
    origin: Array
    """The corner of least coordinates of the cell (0, 0, 0), shape (3,), world frame, in [m]."""
    edges: Array
    """The edge lengths of a cell, shape (3,), in [m]; zero along the axis across a flat map."""
    cells: NDArray[np.int16]
    """The index of each cell along the three axes, shape (n, 3)."""
    name: str = "workspace"

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        """Draw `num` targets, shape (num, 3), world frame, in [m]."""
        cell = self.cells[rng.integers(len(self.cells), size=num)]
        return self.origin + (cell + rng.random((num, 3))) * self.edges

    @property
    def centers(self) -> Array:
        """The centres of the cells, shape (n, 3), world frame, in [m]."""
        return self.origin + (self.cells + 0.5) * self.edges

    def save(self, path: Path) -> None:
        """Write the map to an .npz file."""
        file = io.BytesIO()
        np.savez_compressed(
            file,
            robot=np.array(self.robot),
            origin=self.origin,
            edges=self.edges,
            cells=self.cells.astype(np.int16),
        )
        write_bytes(path, file.getvalue())


def load_workspace(robot: Robot, path: Path | None = None) -> Workspace:
    """Load the map of a robot's workspace.

    Args:
        robot: whose workspace it is.
        path: an .npz file made by `cdcsr workspace`; by default the shipped one.

    Raises:
        CdcsrError: there is no map, it is damaged, or it is of another robot.
    """
    file = f"{robot.name}.npz"
    remedy = f"make one with `cdcsr workspace {robot.name} --out {file}` and give --space {file}"
    if path is None:
        shipped = resources.files("models") / "workspaces" / f"{robot.name}.npz"
        if not shipped.is_file():
            raise CdcsrError(f"There is no map of the workspace of robot {robot.name!r}; {remedy}.")
        data, shown = shipped.read_bytes(), shipped.name
    else:
        try:
            data, shown = path.read_bytes(), str(path)
        except OSError as error:
            raise CdcsrError(f"Cannot read the map {path}: {error.strerror}; {remedy}.") from None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            found = Workspace(
                str(arrays["robot"]), arrays["origin"], arrays["edges"], arrays["cells"]
            )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise CdcsrError(
            f"{shown} is not a map of a workspace ({type(error).__name__}); {remedy}."
        ) from None
    if found.robot != robot.fingerprint:
        raise CdcsrError(
            f"The map {shown} is of another robot ({found.robot}, not {robot.fingerprint}); "
            f"{remedy}."
        )
    return found


def cells_between(reached: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the cells of a grid whose corners were all reached.

    Args:
        reached: indices of the points that were reached, shape (n, 3).

    Returns:
        The corner of least coordinates of each cell, shape (m, 3), and whether the cells extend
        along each axis, shape (3,): if all points have the same index along it, the map is flat.
    """
    if len(reached) < 2:
        return reached.reshape(-1, 3)[:0], np.ones(3, dtype=bool)
    wide = np.ptp(reached, axis=0) > 0
    corners = [
        np.array([i, j, k])
        for i in range(1 + wide[0])
        for j in range(1 + wide[1])
        for k in range(1 + wide[2])
    ]
    points = {tuple(point) for point in reached.tolist()}
    whole = [
        all(tuple((point + corner).tolist()) in points for corner in corners) for point in reached
    ]
    return reached[np.array(whole)], wide
