"""A robot as files that the engines load without this package: MJCF, URDF, meshes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from trimesh.exchange.stl import export_stl

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import write_bytes, write_json, write_text
from cdcsr.robot.description import Robot
from cdcsr.robot.meshes import export_glb, visual_meshes
from cdcsr.simulation.engines import backend_names


def check_backend(backend: str) -> list[str]:
    """The engines meant by a name: one that is installed, or "all" for every engine that has stock model files.

    Raises:
        CdcsrError: no such engine is installed, or it has no stock model files.
    """
    installed = backend_names()
    if backend == "all":
        return [name for name in installed if name in _WRITERS]
    if backend not in installed:
        raise CdcsrError(unknown_choice("backend", backend, [*installed, "all"]))
    if backend not in _WRITERS:
        raise CdcsrError(
            f"There are no stock model files for {backend!r}, only for: {', '.join(sorted(_WRITERS))}."
        )
    return [backend]


def write_model(robot: Robot, folder: Path, backends: Sequence[str]) -> None:
    """Fill a folder with the robot's model files for some engines, its meshes, a GLB scene and its description."""
    meshes = {}
    for part, mesh in visual_meshes(robot).items():
        meshes[part] = f"meshes/{part}.stl"
        write_bytes(folder / meshes[part], export_stl(mesh))
    for backend in backends:
        _WRITERS[backend](robot, folder, meshes)
    export_glb(robot, folder / f"{robot.name}.glb")
    write_text(folder / f"{robot.name}.toml", robot.to_toml())


def _write_mjcf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    from backends.mujoco.model import build_spec

    spec = build_spec(robot, dict(meshes))
    spec.modelfiledir = str(folder)
    spec.compile()
    root = ET.fromstring(spec.to_xml())
    # MuJoCo writes six digits. Places and rest lengths must fit each other better than that, or a cable that
    # is straight at the start hangs loose for the first step.
    exact = {("body", body.name): ("pos", body.pos) for body in spec.bodies}
    exact |= {("site", site.name): ("pos", site.pos) for site in spec.sites}
    exact |= {("spatial", tendon.name): ("range", tendon.range) for tendon in spec.tendons}
    for element in root.iter():
        attribute, numbers = exact.get((element.tag, element.get("name", "")), ("", ()))
        if attribute in element.attrib:
            element.set(attribute, " ".join(repr(float(number)) for number in numbers))
    write_text(folder / f"{robot.name}.xml", ET.tostring(root, encoding="unicode") + "\n")


def _write_urdf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    from backends.pybullet.urdf import cable_file, urdf

    # In URDF every link names its own mesh.
    links = [s for s, segment in enumerate(robot.segments) for _ in range(segment.links)]
    sliders = [s for s, segment in enumerate(robot.segments) for _ in segment.cables.angles_deg]
    mesh_files = {"base": meshes["base"]}
    mesh_files |= {f"link_{j}": meshes[f"link_{s}"] for j, s in enumerate(links)}
    mesh_files |= {f"slider_{c}": meshes[f"slider_{s}"] for c, s in enumerate(sliders)}
    write_text(folder / f"{robot.name}.urdf", urdf(robot, mesh_files))
    write_json(folder / "cables.json", cable_file(robot))


_WRITERS: dict[str, Callable[[Robot, Path, Mapping[str, str]], None]] = {
    "mujoco": _write_mjcf,
    "pybullet": _write_urdf,
}
