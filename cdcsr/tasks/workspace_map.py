"""Maps of a robot's whole workspace: all targets that the demonstrator reaches.

A map is a set of cells of a grid. A cell belongs to it if the demonstrator reaches every corner of
the cell in time. `cdcsr workspace` computes a map.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import note, write_bytes
from cdcsr.reading import MOST_TABLE, digest, read_bytes
from cdcsr.robot.description import Robot, argument_of, differences, parse_robot

Array = NDArray[np.float64]
_OLDER = {f"{name}.npy" for name in ("robot", "origin", "edges", "cells")}
_MEMBERS = _OLDER | {"description.npy", "digest.npy"}
"""The arrays in a file, before and since maps hold the robot and a digest."""


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
    description: str = ""
    """The robot as TOML; empty in maps of older versions."""
    name: str = "workspace"

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        """Draw `num` targets, shape (num, 3), world frame, in [m]."""
        cell = self.cells[rng.integers(len(self.cells), size=num)]
        return self.origin + (cell + rng.random((num, 3))) * self.edges

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Return which points lie in a cell, shape (n,); none does if the map is flat.

        Args:
            points: shape (n, 3), world frame, in [m].
        """
        if not self.edges.all():
            return np.zeros(len(points), dtype=bool)
        low, high = self.cells.min(axis=0), self.cells.max(axis=0)
        filled = np.zeros(high - low + 1, dtype=bool)
        filled[tuple((self.cells - low).T)] = True
        cell = np.floor((points - self.origin) / self.edges) - low
        inside = ((cell >= 0) & (cell < filled.shape)).all(axis=1)
        inside[inside] = filled[tuple(cell[inside].astype(int).T)]
        return inside

    @property
    def centers(self) -> Array:
        """The centres of the cells, shape (n, 3), world frame, in [m]."""
        return self.origin + (self.cells + 0.5) * self.edges

    @property
    def hull(self) -> Array:
        """The corners of the faces that cells share with no other cell, shape (n, 4, 3), world
        frame, in [m]; of a flat map the cells themselves."""
        low = self.cells.min(axis=0)
        held = np.zeros(np.ptp(self.cells, axis=0) + 3, dtype=bool)  # with an empty rim
        held[tuple((self.cells - low + 1).T)] = True
        faces = []
        for axis in range(3):
            across, up = (axis + 1) % 3, (axis + 2) % 3
            if not (self.edges[across] and self.edges[up]):
                continue
            for side in (0, 1):
                outer = held & ~np.roll(held, 1 - 2 * side, axis)
                corners = np.repeat((np.argwhere(outer) + low - 1.0)[:, None], 4, axis=1)
                corners[:, :, axis] += side
                corners[:, 1:3, across] += 1
                corners[:, 2:, up] += 1
                faces.append(corners)
        return self.origin + np.concatenate(faces) * self.edges

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of the content."""
        numbers = self.origin.astype(float), self.edges.astype(float), self.cells.astype(np.int16)
        texts = (self.robot + self.description).encode()
        return digest(texts + b"".join(array.tobytes() for array in numbers))

    def save(self, path: Path) -> None:
        """Write the map to an .npz file."""
        file = io.BytesIO()
        np.savez_compressed(
            file,
            robot=np.array(self.robot),
            origin=self.origin,
            edges=self.edges,
            cells=self.cells.astype(np.int16),
            description=np.array(self.description),
            digest=np.array(self.digest),
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
    remedy = (
        f"make one with `cdcsr workspace {argument_of(robot)} --out {file}` and give --space {file}"
    )
    if path is None:
        shipped = resources.files("models") / "workspaces" / f"{robot.name}.npz"
        if not shipped.is_file():
            raise CdcsrError(f"There is no map of the workspace of robot {robot.name!r}; {remedy}.")
        data, shown = shipped.read_bytes(), shipped.name
    else:
        try:
            data, shown = read_bytes(path, MOST_TABLE, "map"), str(path)
        except CdcsrError as error:
            raise CdcsrError(f"{str(error).removesuffix('.')}; {remedy}.") from None
    try:
        found = _unpacked(data, shown, "workspace" if path is None else str(path))
    # A damaged archive fails in many ways.
    except Exception as error:
        raise CdcsrError(
            f"{shown} is not a map of a workspace ({type(error).__name__}: {error}); {remedy}."
        ) from None
    if found.robot != robot.fingerprint:
        own = found.description and parse_robot(found.description, f"The robot of {shown}")
        why = differences(own, robot) if own else f"{found.robot}, not {robot.fingerprint}"
        raise CdcsrError(f"The map {shown} is of another robot ({why}); {remedy}.")
    return found


def _unpacked(data: bytes, shown: str, name: str) -> Workspace:
    """Return the map in the content of a file, as a space of that name.

    Raises:
        ValueError: the content is no map, or not the one whose digest is in it.
        Exception: the archive is damaged.
    """
    with ZipFile(io.BytesIO(data)) as archive:
        members = {member.filename for member in archive.infolist()}
        if members not in (_OLDER, _MEMBERS):
            raise ValueError(f"it holds {sorted(members)[:8]}")
        if sum(member.file_size for member in archive.infolist()) > MOST_TABLE:
            raise ValueError("it unpacks to more than is allowed")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        origin, edges, cells = (arrays[name] for name in ("origin", "edges", "cells"))
        if (origin.shape, edges.shape) != ((3,), (3,)) or cells.ndim != 2 or cells.shape[1] != 3:
            raise ValueError("its arrays have wrong shapes")
        if not len(cells) or cells.dtype != np.int16:
            raise ValueError("it has no cells")
        if not np.isfinite([origin, edges]).all() or (edges < 0).any():
            raise ValueError("it is not finite")
        if members == _OLDER:
            note(f"The map {shown} is of an older version, without a digest.")
            return Workspace(str(arrays["robot"]), origin, edges, cells, name=name)
        texts = str(arrays["robot"]), str(arrays["description"])
        found = Workspace(texts[0], origin, edges, cells, texts[1], name)
        if str(arrays["digest"]) != found.digest:
            raise ValueError(f"its digest is {found.digest}, not {arrays['digest']}")
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
