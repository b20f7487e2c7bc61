"""A robot as files that engines load without this package: MJCF, URDF, meshes.

An engine brings the exporter of its own files by an entry point in the group `cdcsr.exporters`,
under the engine's name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from trimesh.exchange.stl import export_stl

from cdcsr.files import write_bytes, write_text
from cdcsr.robot.description import Robot
from cdcsr.robot.meshes import export_glb, visual_meshes

Exporter = Callable[[Robot, Path, Mapping[str, str]], None]
"""Writes an engine's files of a robot into a folder. The third argument gives the visual meshes
that are there already: file names relative to the folder by part, which is `base`,
`link_<segment>` or `slider_<segment>`."""
_GROUP = "cdcsr.exporters"


def exporter_names() -> list[str]:
    """Return the names of the installed engines that have model files of their own."""
    return sorted({point.name for point in entry_points(group=_GROUP)})


def write_model(robot: Robot, folder: Path, backends: Sequence[str]) -> None:
    """Fill a folder with the robot's meshes, a GLB scene, its description, and the model files of
    those of the engines that have any."""
    meshes = {}
    for part, mesh in visual_meshes(robot).items():
        meshes[part] = f"meshes/{part}.stl"
        write_bytes(folder / meshes[part], export_stl(mesh))
    for point in entry_points(group=_GROUP):
        if point.name in backends:
            write: Exporter = point.load()
            write(robot, folder, meshes)
    export_glb(robot, folder / f"{robot.name}.glb")
    write_text(folder / f"{robot.name}.toml", robot.to_toml())
