"""Triangle meshes of a robot for pictures, and the inertia of a solid of a given shape.

A part looks as the mesh file that the description names for it, else as drawn here. Masses,
inertias and routing do not come from the meshes but from the description.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange import gltf
from trimesh.transformations import quaternion_matrix, rotation_matrix, translation_matrix
from trimesh.visual import ColorVisuals

from cdcsr import files
from cdcsr.errors import CdcsrError
from cdcsr.robot.colors import DEBRIS, HULL, METAL, PANEL, link_parts, segment_color
from cdcsr.robot.description import Robot, folder_of
from cdcsr.robot.mesh_files import read_mesh
from cdcsr.robot.parts import Link
from cdcsr.robot.routing import Routing, routing

_SECTIONS = 32
_WRONG_UNIT = 1000**0.5
"""A mesh that is larger than its part by more than this is nearer to it in millimetres."""


def visual_meshes(robot: Robot) -> dict[str, trimesh.Trimesh]:
    """Return one mesh for each kind of part, in the frame of its body, in [m].

    Returns:
        `base` (origin at its centre), and for each segment s from 0: `link_<s>` (origin at its
        joint, +z along the link), `link_<s>_<n>` for each link n that differs from its first one,
        `end_<s>` if the last one does, and `slider_<s>` if it has cables (origin at its centre).

    Raises:
        CdcsrError: a mesh file that the description names cannot be read, or is in another unit.
    """
    own = _from_file(robot, robot.base.mesh, "base", max(robot.base.size), HULL)
    meshes = {"base": own or _base(robot)}
    for (link, _), part in zip(robot.links, link_parts(robot), strict=True):
        if part not in meshes:
            meshes[part] = _own_link(robot, link, part) or _link(robot, link, _segment(part))
    for s, segment in enumerate(robot.segments):
        if segment.cable_angles:
            ball = trimesh.creation.icosphere(2, segment.servo.radius)
            meshes[f"slider_{s}"] = _coloured(ball, METAL)
    return meshes


def solid_inertia(mesh: trimesh.Trimesh, mass: float) -> NDArray[np.float64]:
    """Return the inertia tensor of a solid of uniform density.

    Args:
        mesh: its surface, closed.
        mass: in [kg].

    Returns:
        Shape (3, 3), about the solid's centre of mass, along the axes of the mesh, in [kg m^2].

    Raises:
        CdcsrError: the mesh encloses no volume.
    """
    if not mesh.is_volume:
        raise CdcsrError("A solid's inertia needs a closed mesh with its faces turned outward.")
    return np.asarray(mesh.moment_inertia) * (mass / (mesh.volume * mesh.density))


def export_glb(robot: Robot, path: Path, debris: trimesh.Trimesh | None = None) -> None:
    """Write the whole straight robot as one GLB scene, with debris beside it if there is any.

    As glTF asks, up is +y in the scene; that is +z of the arm.

    Raises:
        CdcsrError: the file cannot be written.
    """
    meshes = visual_meshes(robot)
    scene = trimesh.Scene(base_frame="world")
    upright = rotation_matrix(-np.pi / 2, (1, 0, 0))

    def place(
        geometry: str | trimesh.Trimesh, name: str, position: tuple[float, float, float]
    ) -> None:
        # A part that occurs often is stored once and referred to by its name.
        if isinstance(geometry, str) and geometry in scene.geometry:
            scene.graph.update(
                name, matrix=upright @ translation_matrix(position), geometry=geometry
            )
            return
        mesh, key = (meshes[geometry], geometry) if isinstance(geometry, str) else (geometry, name)
        scene.add_geometry(
            mesh, node_name=name, geom_name=key, transform=upright @ translation_matrix(position)
        )

    place("base", "base", (0.0, 0.0, 0.0))
    height = robot.first_joint
    for number, ((link, _), part) in enumerate(zip(robot.links, link_parts(robot), strict=True)):
        place(part, f"link{number}", (0.0, 0.0, height))
        height += link.length
    route = routing(robot)
    kinds = [s for s, segment in enumerate(robot.segments) for _ in segment.cable_angles]
    for c, s in enumerate(kinds):
        x, y = route.place[c]
        low = robot.first_joint - route.guide_offset[c] - route.slider_offset[c]
        # At rest the slider and the guides are in line, so the cable is drawn straight.
        place(f"slider_{s}", f"slider{c}", (x, y, low))
        line = _cable(robot, route, c, low)
        place(_coloured(line, METAL), f"cable{c}", (x, y, low + route.rest_length[c] / 2))
    if debris is not None:
        # The robot's scene is in the frame of its base.
        turned = quaternion_matrix(robot.base.quaternion)
        to_base = np.linalg.inv(translation_matrix(robot.base.position) @ turned)
        floating = _coloured(debris.copy().apply_transform(to_base), DEBRIS)
        place(floating, "debris", (0.0, 0.0, 0.0))
    files.write_bytes(path, gltf.export_glb(scene))


def _segment(part: str) -> int:
    """Return the segment that a link's mesh belongs to, by its name."""
    return int(part.split("_")[1])


def _own_link(robot: Robot, link: Link, part: str) -> trimesh.Trimesh | None:
    """Return the mesh that the description names for a link, if any; along a taper it gets thinner
    with the link."""
    s = _segment(part)
    mesh = _from_file(robot, link.mesh, part, link.length, segment_color(s))
    if mesh is not None and robot.segments[s].taper is not None:
        thinner = link.radius / robot.segments[s].link.radius
        mesh.apply_transform(np.diag([thinner, thinner, 1.0, 1.0]))
    return mesh


def _from_file(
    robot: Robot, name: str | None, part: str, size: float, color: tuple[int, int, int, int]
) -> trimesh.Trimesh | None:
    """Return the mesh that a description names for a part of a given size in [m]; None if it names
    none, or if it was not read from a file, beside which the mesh would lie."""
    if name is None:
        return None
    folder = folder_of(robot)
    if folder is None:
        files.note(
            f"The mesh {name!r} of {robot.name!r} lies beside its description, whose file is not "
            f"known here; its {part} is drawn in the standard shape. Give the .toml as the robot."
        )
        return None
    mesh = read_mesh(folder / name)
    largest = float(max(mesh.extents))
    if not size / _WRONG_UNIT < largest < size * _WRONG_UNIT:
        unit = "millimetres" if largest > size else "another unit"
        raise CdcsrError(
            f"The mesh {folder / name} is {largest:.3g} m large and the {part} of {robot.name!r} "
            f"{size:.3g} m. Coordinates are read as metres, and these look like {unit}: export it "
            "in metres."
        )
    return _coloured(mesh, color)


def _cable(robot: Robot, route: Routing, c: int, slider: float) -> trimesh.Trimesh:
    """Return cable `c` of the straight robot, as seen from the middle of its straight length.

    Args:
        robot: the description.
        route: its routing.
        c: the cable.
        slider: the height of its slider, in [m].
    """
    (x, y), length = route.place[c], route.rest_length[c]
    if route.parallel:
        return trimesh.creation.cylinder(0.0012, height=length, sections=8)
    heights = robot.first_joint + np.cumsum([0.0, *(link.length for link, _ in robot.links)])
    feet = [0.0, *heights[:-1]]
    points = [np.array([x, y, slider])]
    points += [np.add(guide.place, (0, 0, feet[guide.body])) for guide in route.guides[c]]
    pieces = list(pairwise(points))
    lines = [
        trimesh.creation.cylinder(0.0012, segment=np.array(piece), sections=8)
        for n, piece in enumerate(pieces)
        if n != 1 or not route.first[c]  # a sheath is not drawn
    ]
    whole = sum(lines[1:], start=lines[0])
    return whole.apply_translation((-x, -y, -slider - length / 2))


def _base(robot: Robot) -> trimesh.Trimesh:
    """Return a bevelled box with a nozzle below and a solar panel on either side."""
    x, y, z = (edge / 2 for edge in robot.base.size)
    small = min(x, y, z)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    # Each corner is cut back along all axes but one, in turn.
    cut = 0.08 * small * (1 - np.eye(3))
    corners = np.concatenate([signs * (np.array([x, y, z]) - c) for c in cut])
    hull = _coloured(trimesh.convex.convex_hull(corners), HULL)
    throat, mouth, end = 0.2 * small, 0.45 * small, -z - 0.5 * small
    nozzle = _revolved(
        [(0, -z - 0.05 * small), (0.9 * mouth, end), (mouth, end), (throat, -z), (0, -z)]
    )
    parts = [_coloured(nozzle, METAL)]
    for side in (-1, 1):
        panel = trimesh.creation.box((1.2 * x, 2.4 * y, 0.05 * small))
        panel.apply_translation((0, side * (y + 0.2 * small + 1.2 * y), 0))
        boom = trimesh.creation.box((0.1 * small, 0.4 * small, 0.05 * small))
        boom.apply_translation((0, side * (y + 0.1 * small), 0))
        parts += [_coloured(panel, PANEL), _coloured(boom, METAL)]
    stub = robot.segments[0].stub
    if stub is not None:
        rod = trimesh.creation.cylinder(stub.radius, stub.length, sections=_SECTIONS)
        rod.apply_translation((0, 0, z + stub.length / 2))
        parts.append(_coloured(rod, segment_color(0)))
    return sum(parts, start=hull)


def _link(robot: Robot, link: Link, s: int) -> trimesh.Trimesh:
    """Return a link of segment `s`: a backbone with a ball at its joint and a disc at each guide of
    a passing cable."""
    passing = [segment.cables for segment in robot.segments[s:] if segment.cable_angles]
    pitch = max((cables.widest for cables in passing), default=link.radius)
    backbone, disc = 0.45 * min(pitch, link.radius), 1.6 * pitch
    if robot.segments[s].backbone is not None:
        backbone = link.radius
    offsets = {cables.guide_offset for cables in passing}
    heights = sorted(offsets | {link.length - offset for offset in offsets})
    gaps = np.diff([0.0, *heights, link.length])
    half = min(0.002, 0.3 * float(gaps.min()))
    ball = np.linspace(-np.pi / 2, 0, 6)
    profile = [(backbone * np.cos(angle), backbone * np.sin(angle)) for angle in ball]
    for z in heights:
        profile += [(backbone, z - half), (disc, z - half), (disc, z + half), (backbone, z + half)]
    profile += [(backbone, link.length), (0.0, link.length)]
    return _coloured(_revolved(profile), segment_color(s))


def _revolved(profile: list[tuple[float, float]]) -> trimesh.Trimesh:
    """Return the solid that a profile of (radius, z) sweeps around z."""
    points = np.array(profile)
    size = points.max()  # trimesh joins points nearer than 1e-8: of a link of 10 mm too many
    return trimesh.creation.revolve(points / size, sections=_SECTIONS).apply_scale(size)


def _coloured(mesh: trimesh.Trimesh, colour: tuple[int, int, int, int]) -> trimesh.Trimesh:
    mesh.visual = ColorVisuals(mesh, face_colors=colour)
    return mesh
