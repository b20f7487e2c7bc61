"""`cdcsr demonstrate`: record demonstrations."""

from __future__ import annotations

from pathlib import Path


def demonstrate(
    *,
    out: Path,
    backend: str = "mujoco",
    space: str = "anchor",
    episodes: int = 10,
    seed: int = 0,
    robot: str = "paper",
    frame_skip: int = 1,
    task: str = "reach",
    force: bool = False,
    json: Path | None = None,
) -> None:
    """Record episodes of the scripted demonstrator into a Minari dataset.

    Args:
        out: the folder of the dataset.
        backend: the engine.
        space: the operation space of the targets: anchor, floating, spatter or workspace.
        episodes: how many successful episodes.
        seed: seed of the targets.
        robot: a shipped robot's name, or a path ending in .toml.
        frame_skip: how many simulation steps each command is held for.
        task: reach, precise, quiet, capture, capture-drift, capture-tumble, follow-line,
            follow-circle or follow-random.
        force: replace an existing folder.
        json: also write the summary to this file.
    """
    from cdcsr.envs.gym_env import TaskVectorEnv
    from cdcsr.errors import CdcsrError
    from cdcsr.files import new_folder, write_json
    from controllers import demonstrations
    from controllers.jacobian import JacobianController

    if episodes < 1:
        raise CdcsrError(f"episodes must be at least 1, not {episodes}.")
    with new_folder(out, "demonstrations", force) as folder:
        env = TaskVectorEnv(
            episodes,
            robot,
            backend,
            space,
            frame_skip=frame_skip,
            task=task,
            autoreset_mode="Disabled",
        )
        controller = JacobianController(env.robot)
        recorded, failed = demonstrations.record(controller, env, episodes, seed)
        demonstrations.save(folder, recorded, env, controller.name, out.name)
        env.close()
    lengths = [frame_skip * episode.length for episode in recorded]
    summary = {
        "out": str(out),
        "robot": env.robot.name,
        "task": env.task.name,
        "backend": backend,
        "space": space,
        "seed": seed,
        "episodes": len(recorded),
        "failed": failed,
        "steps": sum(lengths),
        "length_mean": sum(lengths) / len(lengths),
        "targets": [episode.target.tolist() for episode in recorded],
    }
    print(
        f"{len(recorded)} demonstrations of {env.robot.name} in {backend} ({env.task.name}, "
        f"{space}, seed {seed}): {sum(lengths)} steps, {summary['length_mean']:.1f} on average, "
        f"{failed} failed and drawn anew -> {out}"
    )
    if json is not None:
        write_json(json, summary)
