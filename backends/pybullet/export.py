"""The URDF file of a robot and the file of its cables: the exporter that PyBullet brings to
`cdcsr build-model`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from backends.pybullet.urdf import cable_file, urdf
from cdcsr.files import write_json, write_text
from cdcsr.robot.colors import link_parts
from cdcsr.robot.description import Robot

DRIVER = "drive_pybullet.py"


def write_urdf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    """Write `<robot>.urdf`, `cables.json` and a script that drives them; see
    :data:`backends.export.model_files.Exporter`."""
    # In URDF every link names its own mesh.
    sliders = [s for s, segment in enumerate(robot.segments) for _ in segment.cable_angles]
    mesh_files = {"base": meshes["base"]}
    mesh_files |= {f"link_{j}": meshes[part] for j, part in enumerate(link_parts(robot))}
    mesh_files |= {f"slider_{c}": meshes[f"slider_{s}"] for c, s in enumerate(sliders)}
    write_text(folder / f"{robot.name}.urdf", urdf(robot, mesh_files, world=True))
    write_json(folder / "cables.json", cable_file(robot))
    driver = resources.files("backends.pybullet") / DRIVER
    write_text(folder / DRIVER, driver.read_text("utf-8"))
