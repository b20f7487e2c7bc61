"""A robot as files that engines load without this package: MJCF, URDF, meshes.

An engine brings the exporter of its own files by an entry point in the group `cdcsr.exporters`,
under the engine's name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import TypeVar

from trimesh import Trimesh
from trimesh.exchange.stl import export_stl

from cdcsr.files import note, write_bytes, write_text
from cdcsr.robot.colors import link_parts
from cdcsr.robot.description import Base, Robot
from cdcsr.robot.meshes import export_glb, visual_meshes
from cdcsr.robot.parts import Link

Exporter = Callable[[Robot, Path, Mapping[str, str]], None]
"""Writes an engine's files of a robot into a folder. The third argument gives the visual meshes
that are there already: file names relative to the folder by part, which is `base`,
`link_<segment>` or `slider_<segment>`."""
_GROUP = "cdcsr.exporters"
_Look = TypeVar("_Look", Base, Link)


def exporter_names() -> list[str]:
    """Return the names of the installed engines that have model files of their own."""
    return sorted({point.name for point in entry_points(group=_GROUP)})


def write_model(
    robot: Robot, folder: Path, backends: Sequence[str], debris: Trimesh | None = None
) -> None:
    """Fill a folder with the robot's meshes, a GLB scene, its description, and the model files of
    those of the engines that have any.

    Args:
        robot: the description.
        folder: where the files are written.
        backends: the engines.
        debris: what stands in the scene beside the robot, in the world frame, in [m].
    """
    if any(robot.guide_friction):
        note("The model files leave out the friction of cables in their guides.")
    meshes = {}
    for part, mesh in visual_meshes(robot).items():
        meshes[part] = f"meshes/{part}.stl"
        write_bytes(folder / meshes[part], export_stl(mesh))
    for point in entry_points(group=_GROUP):
        if point.name in backends:
            write: Exporter = point.load()
            write(robot, folder, meshes)
    export_glb(robot, folder / f"{robot.name}.glb", debris)
    write_text(folder / f"{robot.name}.toml", _moved(robot, meshes).to_toml())


def _moved(robot: Robot, meshes: Mapping[str, str]) -> Robot:
    """Return a description that names the written meshes in place of the files it was read with."""

    def looks(part: _Look, name: str) -> _Look:
        return part.model_copy(update={"mesh": meshes[name]}) if part.mesh else part

    segments, parts = [], link_parts(robot)
    for s, segment in enumerate(robot.segments):
        own = segment.own_link and looks(segment.own_link, f"link_{s}")
        chain = tuple(looks(link, parts[n]) for n, link in enumerate(segment.own_chain))
        segments.append(segment.model_copy(update={"own_link": own, "own_chain": chain}))
        parts = parts[segment.links :]
    update = {"base": looks(robot.base, "base"), "segments": tuple(segments)}
    return robot.model_copy(update=update)
