"""Visual meshes stand where the bodies stand, and a solid's inertia is the textbook's."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot, shipped_robots
from cdcsr.robot.meshes import export_glb, solid_inertia, visual_meshes


def test_inertia_of_a_box() -> None:
    a, b, c, mass = 0.2, 0.3, 0.5, 7.0
    box = trimesh.creation.box((a, b, c))
    box.apply_translation((1, 2, 3))  # about its own centre, wherever it stands
    expected = mass / 12 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    np.testing.assert_allclose(solid_inertia(box, mass), expected, atol=1e-12)


def test_inertia_of_a_turned_box_keeps_its_principal_moments() -> None:
    box = trimesh.creation.box((0.2, 0.3, 0.5))
    moments = np.diag(solid_inertia(box, 7.0))
    box.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    np.testing.assert_allclose(
        np.linalg.eigvalsh(solid_inertia(box, 7.0)), np.sort(moments), rtol=1e-12
    )


def test_inertia_of_a_cylinder() -> None:
    radius, height, mass, sections = 0.02, 0.2, 1.18, 400
    cylinder = trimesh.creation.cylinder(radius, height, sections=sections)
    across = mass * (3 * radius**2 + height**2) / 12
    expected = np.diag([across, across, mass * radius**2 / 2])
    # A polygon of n corners falls short of its circle's second moment by a few parts in n^2.
    np.testing.assert_allclose(
        solid_inertia(cylinder, mass), expected, rtol=20 / sections**2, atol=1e-12
    )


def test_inertia_does_not_depend_on_a_meshs_density() -> None:
    box = trimesh.creation.box((1, 1, 1))
    box.density = 3.0
    np.testing.assert_allclose(np.diag(solid_inertia(box, 6.0)), [1.0, 1.0, 1.0])


def test_an_open_mesh_has_no_inertia() -> None:
    box = trimesh.creation.box((1, 1, 1))
    box.update_faces(np.arange(len(box.faces)) > 0)
    with pytest.raises(CdcsrError, match="closed mesh"):
        solid_inertia(box, 1.0)


@pytest.mark.parametrize("name", shipped_robots())
def test_every_part_has_a_closed_mesh_in_its_bodys_frame(name: str) -> None:
    robot = load_robot(name)
    meshes = visual_meshes(robot)
    expected = {"base"} | {
        f"{part}_{s}" for part in ("link", "slider") for s in range(robot.num_segments)
    }
    assert set(meshes) == expected
    assert all(mesh.is_volume for mesh in meshes.values())
    # The arm begins on the base's top face.
    assert meshes["base"].bounds[1, 2] == pytest.approx(robot.top)
    for s, segment in enumerate(robot.segments):
        link, slider = meshes[f"link_{s}"], meshes[f"slider_{s}"]
        assert link.bounds[1, 2] == pytest.approx(segment.link.length)
        assert -segment.link.radius <= link.bounds[0, 2] <= 0
        np.testing.assert_allclose(link.extents[:2], 2 * 1.6 * segment.cables.pitch_radius)
        np.testing.assert_allclose(slider.extents, 2 * segment.servo.radius, rtol=0.01)
        np.testing.assert_allclose(slider.center_mass, 0, atol=1e-9)


def test_the_scene_holds_every_body_upright(tmp_path: Path) -> None:
    robot = load_robot("paper")
    export_glb(robot, tmp_path / "paper.glb")
    scene = trimesh.load_scene(io.BytesIO((tmp_path / "paper.glb").read_bytes()), file_type="glb")
    # One base, 12 links, 8 sliders, 8 cables; glTF's up is y.
    assert len(scene.graph.nodes_geometry) == 1 + 12 + 8 + 8
    assert scene.bounds is not None
    assert scene.bounds[1, 1] == pytest.approx(robot.top + robot.arm_length)
    height = scene.graph["link11"][0][1, 3]
    assert height == pytest.approx(0.3 + 11 * 0.2)
