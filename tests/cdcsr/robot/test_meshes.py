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
from cdcsr.robot.colors import HULL, METAL, PANEL, segment_color, share
from cdcsr.robot.description import load_robot, parse_robot, shipped_robots
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
    assert segment_color(3) == segment_color(0)
    assert share((255, 0, 51, 102)) == (1.0, 0.0, 0.2, 0.4)


def with_looks(folder: Path, base: str, link: str) -> Path:
    """Write the paper's robot with meshes of its own: a base of 1 m, and open tubes as links."""
    trimesh.creation.box((1.0, 0.5, 0.6)).export(folder / "hull.stl")
    tube = trimesh.creation.cylinder(0.03, 0.2)
    tube.update_faces(np.abs(tube.face_normals[:, 2]) < 0.5)
    tube.apply_translation((0, 0, 0.1)).export(folder / "tube.ply")
    text = load_robot("paper").to_toml()
    text = text.replace("[base]\n", f'[base]\nmesh = "{base}"\n')
    text = text.replace("[segments.link]\n", f'[segments.link]\nmesh = "{link}"\n', 1)
    (folder / "own.toml").write_text(text.replace('"paper"', '"own-looks"'))
    return folder / "own.toml"


def test_parts_look_as_the_files_that_the_description_names(tmp_path: Path) -> None:
    paper, robot = load_robot("paper"), load_robot(with_looks(tmp_path, "hull.stl", "tube.ply"))
    meshes, usual = visual_meshes(robot), visual_meshes(paper)
    np.testing.assert_allclose(meshes["base"].extents, (1.0, 0.5, 0.6))
    np.testing.assert_allclose(meshes["link_0"].bounds[:, 2], (0.0, 0.2), atol=1e-7)
    assert meshes["link_0"].area == pytest.approx(2 * np.pi * 0.03 * 0.2, rel=0.01)
    np.testing.assert_array_equal(meshes["link_1"].vertices, usual["link_1"].vertices)
    assert _color(meshes["link_0"]) == _color(usual["link_0"])
    # They change neither the motion nor what older descriptions are.
    assert robot.fingerprint == paper.fingerprint
    assert "mesh" not in paper.to_toml()


def test_a_tapered_link_has_a_thinner_mesh(tmp_path: Path) -> None:
    path = with_looks(tmp_path, "hull.stl", "tube.ply")
    tapered = path.read_text().replace(
        "[segments.link]\n", "[segments.taper]\nradius = 0.5\nmass = 0.5\n\n[segments.link]\n", 1
    )
    path.write_text(tapered)
    meshes = visual_meshes(load_robot(path))
    np.testing.assert_allclose(meshes["link_0"].extents, (0.06, 0.06, 0.2), rtol=0.01)
    np.testing.assert_allclose(meshes["end_0"].extents, (0.03, 0.03, 0.2), rtol=0.01)


@pytest.mark.parametrize(
    ("base", "link", "words"),
    [
        ("none.stl", "tube.ply", r"Cannot read the mesh .*none\.stl: No such file"),
        ("hull.stl", "hull.step", r"line \d+.*must be the path of a mesh that ends in \.stl"),
        (
            "hull.stl",
            "mm.stl",
            r"mm\.stl is 200 m large and the link_0 .* 0\.2 m.*like millimetres",
        ),
    ],
)
def test_meshes_that_are_no_look_are_refused(
    tmp_path: Path, base: str, link: str, words: str
) -> None:
    trimesh.creation.box((20.0, 20.0, 200.0)).export(tmp_path / "mm.stl")
    with pytest.raises(CdcsrError, match=words):
        visual_meshes(load_robot(with_looks(tmp_path, base, link)))


def test_without_its_file_a_description_is_drawn_in_the_standard_shape(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = with_looks(tmp_path, "hull.stl", "tube.ply").read_text()
    moved = parse_robot(text.replace("own-looks", "from-a-policy"))
    usual = visual_meshes(load_robot("paper"))
    np.testing.assert_array_equal(visual_meshes(moved)["base"].vertices, usual["base"].vertices)
    assert "'hull.stl' of 'from-a-policy' lies beside its description" in capsys.readouterr().err


def test_debris_stands_in_the_scene_where_it_is_in_the_world(tmp_path: Path) -> None:
    """The base stands at (1, 2, 3) m, turned by 90 degrees about x: the world's (1, 2, 5) m is its
    (0, 2, 0), and glTF's (0, 0, -2)."""
    paper = load_robot("paper")
    turned = {"position": (1.0, 2.0, 3.0), "quaternion": (0.5**0.5, 0.5**0.5, 0.0, 0.0)}
    robot = paper.model_copy(update={"base": paper.base.model_copy(update=turned)})
    debris = trimesh.creation.icosphere(2, 0.1).apply_translation((1.0, 2.0, 5.0))
    export_glb(robot, tmp_path / "scene.glb", debris)
    scene = trimesh.load_scene(io.BytesIO((tmp_path / "scene.glb").read_bytes()), file_type="glb")
    place, name = scene.graph["debris"]
    center = (place @ [*scene.geometry[name].centroid, 1.0])[:3]
    np.testing.assert_allclose(center, (0.0, 0.0, -2.0), atol=1e-6)


def _color(mesh: trimesh.Trimesh) -> tuple[int, ...]:
    assert isinstance(mesh.visual, ColorVisuals)
    return tuple(int(part) for part in mesh.visual.face_colors[0])


def _slices(mesh: trimesh.Trimesh) -> list[tuple[float, NDArray[np.float64]]]:
    """Return the vertices of a mesh at each height."""
    heights = np.unique(mesh.vertices[:, 2].round(6))
    return [
        (float(z), mesh.vertices[np.isclose(mesh.vertices[:, 2], z, atol=1e-6)]) for z in heights
    ]
