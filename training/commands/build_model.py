"""Sub-commands about models. What is heavy is imported where it is used; see :mod:`cdcsr.cli`."""

from __future__ import annotations

from pathlib import Path


def build_model(
    robot: str, /, *, out: Path, backend: str = "all", force: bool = False, json: Path | None = None
) -> None:
    """Write a robot as stock model files that the engines load on their own.

    MJCF for MuJoCo with cables as spatial tendons; URDF for PyBullet, with the cables, which URDF has no words
    for, in cables.json beside it. Also meshes, a GLB scene, and the description. Prints what the robot weighs
    and how far apart the engines' mass matrices are.

    Args:
        robot: a shipped robot, or a path ending in .toml.
        out: the folder to write.
        backend: the engine to write for, or "all".
        force: replace the folder if it is there already.
        json: also write the summary to this file.
    """
    from backends.export.model_files import check_backend, write_model
    from backends.export.summary import show, summarize
    from cdcsr.files import new_folder, write_json
    from cdcsr.robot.description import load_robot

    description = load_robot(robot)
    backends = check_backend(backend)
    with new_folder(out, "models of a robot", force) as folder:
        write_model(description, folder, backends)
        summary = summarize(description, backends)
        names = sorted(path.name for path in folder.iterdir())
    print(show(summary))
    print(f"written to {out}: {', '.join(names)}")
    if json is not None:
        write_json(json, summary)
