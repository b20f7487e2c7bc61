"""The URDF file of a robot and the file of its cables: the exporter that PyBullet brings to
`cdcsr build-model`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from backends.pybullet.urdf import cable_file, urdf
from cdcsr.files import write_json, write_text
from cdcsr.robot.description import Robot


def write_urdf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    """Write `<robot>.urdf` and `cables.json`; see :data:`backends.export.model_files.Exporter`."""
    # In URDF every link names its own mesh.
    links = [s for s, segment in enumerate(robot.segments) for _ in range(segment.links)]
    sliders = [s for s, segment in enumerate(robot.segments) for _ in segment.cables.angles_deg]
    mesh_files = {"base": meshes["base"]}
    mesh_files |= {f"link_{j}": meshes[f"link_{s}"] for j, s in enumerate(links)}
    mesh_files |= {f"slider_{c}": meshes[f"slider_{s}"] for c, s in enumerate(sliders)}
    write_text(folder / f"{robot.name}.urdf", urdf(robot, mesh_files))
    write_json(folder / "cables.json", cable_file(robot))
