"""`cdcsr build-model`: write a robot's model files."""

from __future__ import annotations

from pathlib import Path


def build_model(
    robot: str,
    /,
    *,
    out: Path,
    backend: str = "all",
    debris: Path | None = None,
    force: bool = False,
    json: Path | None = None,
) -> None:
    """Write a robot as stock model files that the engines load on their own.

    For MuJoCo this is MJCF, with the cables as spatial tendons; for PyBullet it is URDF, and beside
    it cables.json, as URDF cannot describe cables. An engine that brings no exporter is named. The
    folder also gets meshes, a GLB scene, and the description. The command prints what the robot
    weighs and how far apart the engines' mass matrices are.

    Args:
        robot: a shipped robot, or a path ending in .toml.
        out: the folder to write.
        backend: the engine to write for, or "all".
        debris: a mesh (.stl, .obj, .ply, .glb) that stands in the GLB scene beside the robot.
        force: replace the folder if it is there already.
        json: also write the summary to this file.
    """
    from backends.export.model_files import exporter_names, write_model
    from backends.export.summary import show, summarize
    from cdcsr.files import write_json
    from cdcsr.folders import new_folder
    from cdcsr.robot.description import load_robot
    from cdcsr.robot.mesh_files import read_mesh
    from cdcsr.simulation.engines import chosen_backends, engine_title, load_backend

    description = load_robot(robot)
    mesh = None if debris is None else read_mesh(debris, "debris")
    backends = chosen_backends(backend, description)
    with new_folder(out, "models of a robot", force) as folder:
        write_model(description, folder, backends, mesh)
        summary = summarize(description, backends)
        names = sorted(path.name for path in folder.iterdir())
    print(show(summary))
    print(f"written to {out}: {', '.join(names)}")
    for name in backends:
        if name not in exporter_names():
            original = load_backend(name).variant_of
            runs = f"; it runs those of {engine_title(original)}" if original else ""
            print(f"{engine_title(name)} has no model files of its own{runs}")
    if json is not None:
        write_json(json, summary)
