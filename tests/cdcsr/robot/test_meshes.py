"""Visual meshes stand where the bodies stand, and a solid's inertia is the textbook's."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from cdcsr.errors import CdcsrError
from cdcsr.robot.colors import HULL, METAL, PANEL
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


def test_the_parts_of_the_base_touch_each_other() -> None:
    """A base of 1 x 0.8 x 0.6 m, whose least half edge is 0.3 m. Panels are 0.6 of it wide and 1.2
    times as long; booms of 0.12 m bridge the gap of 0.06 m; the nozzle is 0.15 m high."""
    paper = load_robot("paper")
    base = paper.base.model_copy(update={"size": (1.0, 0.8, 0.6)})
    mesh = visual_meshes(paper.model_copy(update={"base": base}))["base"]
    parts = {
        color: [part for part in mesh.split() if _color(part) == color]
        for color in (HULL, PANEL, METAL)
    }
    (hull,) = parts[HULL]
    np.testing.assert_allclose(hull.bounds, [[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]])
    # Twelve edges and eight corners are cut off by 0.024 m.
    assert 0.97 < hull.volume / 0.48 < 1
    assert len(parts[PANEL]) == 2
    for panel in parts[PANEL]:
        np.testing.assert_allclose(panel.extents, [0.6, 0.96, 0.015])
        side = np.sign(panel.center_mass[1])
        np.testing.assert_allclose(panel.center_mass, [0, side * (0.46 + 0.48), 0], atol=1e-12)
    nozzle, *booms = sorted(parts[METAL], key=lambda part: part.bounds[0, 2])
    np.testing.assert_allclose(nozzle.bounds[:, 2], [-0.45, -0.3])
    np.testing.assert_allclose(nozzle.extents[:2], 2 * 0.135)
    # A cone between the radii 0.06 and 0.135 m, hollow but for its upper tenth.
    r, s, h = 0.06, 0.135, 0.15
    whole = np.pi * h / 3 * (r * r + r * s + s * s)
    hollow = np.pi * (0.9 * s) ** 2 * (h - 0.015) / 3
    assert nozzle.volume == pytest.approx(whole - hollow, rel=0.01)
    assert len(booms) == 2
    for boom in booms:
        np.testing.assert_allclose(boom.extents, [0.03, 0.12, 0.015])
        side = np.sign(boom.center_mass[1])
        np.testing.assert_allclose(boom.center_mass, [0, side * 0.43, 0], atol=1e-12)


def test_cables_and_sliders_of_the_scene_are_in_line_at_rest(tmp_path: Path) -> None:
    """The paper's guides lie 0.02 m from the joints and its sliders 0.2 m below the first guide, so
    that a cable begins at 0.08 m; those of the second segment end 2.6 m further up."""
    export_glb(load_robot("paper"), tmp_path / "paper.glb")
    scene = trimesh.load_scene(io.BytesIO((tmp_path / "paper.glb").read_bytes()), file_type="glb")
    side = 0.02 / np.sqrt(2)  # the second segment's cables are turned by 45 degrees
    for cable, start, length in ((0, [0.02, 0.08, 0.0], 1.4), (5, [-side, 0.08, -side], 2.6)):
        slider = scene.graph[f"slider{cable}"][0][:3, 3]
        np.testing.assert_allclose(slider, start, atol=1e-6)
        place, mesh = scene.graph[f"cable{cable}"]
        np.testing.assert_allclose(place[1, 3], 0.08 + length / 2, atol=1e-6)
        np.testing.assert_allclose(scene.geometry[mesh].extents.max(), length, rtol=1e-6)


def test_a_link_is_a_rod_with_a_disc_at_each_guide() -> None:
    """The paper's link: a rod of radius 0.009 m, 0.2 m long, a ball below, and discs of radius
    0.032 m and thickness 0.004 m, by 0.02 m from either end."""
    link = visual_meshes(load_robot("paper"))["link_0"]
    assert link.bounds[0, 2] == pytest.approx(-0.009)
    widths = {z: np.hypot(*points[:, :2].T).max() for z, points in _slices(link)}
    assert {round(z, 4) for z, r in widths.items() if r > 0.03} == {0.018, 0.022, 0.178, 0.182}
    volume = np.pi * (0.009**2 * 0.2 + 2 / 3 * 0.009**3 + 2 * 0.004 * (0.032**2 - 0.009**2))
    assert link.volume == pytest.approx(volume, rel=0.02)
    tallest = visual_meshes(load_robot("three-segment"))
    colors = [_color(tallest[f"link_{s}"])[:3] for s in range(3)]
    assert colors == [(225, 120, 50), (60, 140, 200), (90, 170, 90)]


def _color(mesh: trimesh.Trimesh) -> tuple[int, ...]:
    assert isinstance(mesh.visual, ColorVisuals)
    return tuple(int(part) for part in mesh.visual.face_colors[0])


def _slices(mesh: trimesh.Trimesh) -> list[tuple[float, NDArray[np.float64]]]:
    """Return the vertices of a mesh at each height."""
    heights = np.unique(mesh.vertices[:, 2].round(6))
    return [
        (float(z), mesh.vertices[np.isclose(mesh.vertices[:, 2], z, atol=1e-6)]) for z in heights
    ]
