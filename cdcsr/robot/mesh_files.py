"""Triangle meshes in files: STL, OBJ, PLY and GLB; what is no usable mesh is refused.

Coordinates are read as metres. In a GLB file up is +y, as glTF asks; it is turned so that up is +z.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import AfterValidator

from cdcsr.errors import CdcsrError
from cdcsr.files import note
from cdcsr.reading import read_bytes

if TYPE_CHECKING:
    from trimesh import Trimesh

ENDINGS = (".stl", ".obj", ".ply", ".glb")
"""How the names of mesh files end."""
MOST_BYTES, MOST_TRIANGLES = 1 << 26, 200_000
"""The largest file in bytes, and the most triangles; MuJoCo takes no more of them."""
_UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Turns +y into +z."""


def is_mesh(name: str) -> bool:
    """Return whether a name is that of a mesh file."""
    return name.lower().endswith(ENDINGS)


def _mesh_name(name: str) -> str:
    """Check that a name in a description is that of a mesh file."""
    if not is_mesh(name):
        raise ValueError(f"must be the path of a mesh that ends in {', '.join(ENDINGS)}")
    return name


MeshName = Annotated[str, AfterValidator(_mesh_name)]
"""The path of a mesh, relative to the description's file."""


def read_mesh(path: Path, what: str = "mesh") -> Trimesh:
    """Return the one surface that all bodies in a file make, in [m], turned outward.

    A note tells of holes and of faces that are turned inward. Files that a mesh refers to, such as
    textures, are not read.

    Raises:
        CdcsrError: it is no mesh file, is damaged or too large, or has no surface.
    """
    import trimesh  # takes half a second

    if not is_mesh(path.name):
        raise CdcsrError(
            f"A {what} is a file that ends in {', '.join(ENDINGS)}, not {path.name!r}."
        )
    data = read_bytes(path, MOST_BYTES, what)
    kind = path.suffix.lower().removeprefix(".")
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind)
        assert isinstance(mesh, trimesh.Trimesh)
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)  # without normals and textures
    # A damaged file fails in many ways.
    except Exception as error:
        raise CdcsrError(
            f"The {what} {path} cannot be read as {kind.upper()} ({type(error).__name__}: "
            f"{error}); export it again."
        ) from None
    if len(mesh.faces) > MOST_TRIANGLES:
        raise CdcsrError(
            f"The {what} {path} has {len(mesh.faces):,} triangles, and at most {MOST_TRIANGLES:,} "
            "are allowed; export it with a coarser resolution."
        )
    finite = len(mesh.vertices) > 3 and np.isfinite(mesh.vertices).all()
    if not finite or not len(mesh.faces) or not 0 < mesh.area < np.inf:
        raise CdcsrError(
            f"The {what} {path} has no surface: it needs triangles with an area, four corners or "
            "more, and finite coordinates; export the body as a triangle mesh."
        )
    if kind == "glb":
        mesh.apply_transform(_UPRIGHT)
    _tell_flaws(mesh, f"The {what} {path}")
    return mesh


def _tell_flaws(mesh: Trimesh, what: str) -> None:
    """Turn a closed surface outward, and tell of what may be wrong with a surface."""
    if not mesh.is_watertight:
        note(
            f"{what} has holes or edges that more than two triangles share; its missing parts stay "
            "missing. If they should be there, close them in your CAD program."
        )
    elif not mesh.is_winding_consistent:
        note(
            f"{what} has faces that are turned inward beside others that are turned outward; parts "
            "of it may look dark. Let your CAD program recalculate its normals."
        )
    elif mesh.volume < 0:
        mesh.invert()
        note(f"{what} has its faces turned inward; they are turned outward here.")
