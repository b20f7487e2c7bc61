"""Mesh files: the same body is read from every format, and what is no body is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.exchange import gltf

from cdcsr.errors import CdcsrError
from cdcsr.robot.mesh_files import ENDINGS, MOST_BYTES, read_mesh


def box() -> trimesh.Trimesh:
    """A box of 1 x 2 x 3 m whose lower corner is at (10, 20, 30) m."""
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    return mesh.apply_translation((10.5, 21.0, 31.5))


def test_every_format_gives_the_same_body(tmp_path: Path) -> None:
    """In GLB y is up: the point (x, y, z) stands there as (x, z, -y). The scene
    places the body by a matrix."""
    for ending in ENDINGS:
        path = tmp_path / f"Box{ending.upper()}"
        if ending == ".glb":
            mesh = box()
            x, y, z = mesh.vertices.T
            mesh.vertices = np.column_stack([x, z, -y])
            scene = trimesh.Scene()
            moved = trimesh.transformations.translation_matrix((5, 0, 0))
            scene.add_geometry(mesh.copy().apply_translation((-5, 0, 0)), transform=moved)
            path.write_bytes(gltf.export_glb(scene))
        else:
            path.write_bytes(_data(box(), ending))
        found = read_mesh(path)
        np.testing.assert_allclose(found.bounds, [[10, 20, 30], [11, 22, 33]], rtol=1e-6)
        assert found.volume == pytest.approx(6.0, rel=1e-5)
        assert found.area == pytest.approx(2 * (2 + 3 + 6), rel=1e-6)


def test_faces_that_are_turned_inward_are_turned_outward(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = box()
    mesh.invert()
    (tmp_path / "inward.stl").write_bytes(_data(mesh, ".stl"))
    assert read_mesh(tmp_path / "inward.stl").volume == pytest.approx(6.0, rel=1e-5)
    assert "turned inward; they are turned outward here" in capsys.readouterr().err


def test_holes_and_mixed_faces_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without two of its twelve triangles the box has 22 m^2 less one of its sides."""
    hole, mixed = box(), box()
    side = np.abs(hole.face_normals[:, 0] - 1) < 1e-9
    hole.update_faces(~side)
    (tmp_path / "hole.ply").write_bytes(_data(hole, ".ply"))
    assert read_mesh(tmp_path / "hole.ply", "debris").area == pytest.approx(22 - 6, rel=1e-6)
    assert "hole.ply has holes" in capsys.readouterr().err
    mixed.faces[0] = mixed.faces[0][::-1]
    (tmp_path / "mixed.ply").write_bytes(_data(mixed, ".ply"))
    read_mesh(tmp_path / "mixed.ply")
    assert "recalculate its normals" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("body.step", b"ISO-10303-21;", r"ends in \.stl, \.obj, \.ply, \.glb, not 'body\.step'"),
        ("empty.stl", b"", "no surface"),
        ("empty.stl", b"solid x\nendsolid x\n", "no surface"),
        ("cut.stl", None, "no surface"),
        ("cut.ply", None, "cannot be read as PLY .* export it again"),
        ("cut.glb", None, "cannot be read as GLB .* export it again"),
        ("wild.obj", b"v 0 0 0\nf 1 2 3\n", "cannot be read as OBJ"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\nf 1 2 3\n", "no surface"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n", "no surface"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no surface|cannot be read"),
    ],
)
def test_what_is_no_mesh_is_refused(
    tmp_path: Path, name: str, data: bytes | None, words: str
) -> None:
    if data is None:
        data = _data(box(), Path(name).suffix)[:400]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(CdcsrError, match=words):
        read_mesh(tmp_path / name)


def test_files_and_meshes_have_a_largest_size(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(CdcsrError, match="67,108,865 bytes, and at most 67,108,864"):
        read_mesh(tmp_path / "large.stl")
    fine = trimesh.creation.icosphere(7)  # 20 * 4**7 triangles
    (tmp_path / "fine.stl").write_bytes(_data(fine, ".stl"))
    with pytest.raises(CdcsrError, match=r"327,680 triangles, and at most 200,000 .* coarser"):
        read_mesh(tmp_path / "fine.stl")


def _data(mesh: trimesh.Trimesh, ending: str) -> bytes:
    data = mesh.export(file_type=ending[1:])
    return data.encode() if isinstance(data, str) else bytes(data)
