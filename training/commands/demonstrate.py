"""`cdcsr demonstrate`: record demonstrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from controllers.rollout import Episode


def demonstrate(
    *,
    out: Path,
    robot: str = "paper",
    frame_skip: int | None = None,
    backend: str = "mujoco",
    space: str = "anchor",
    task: str = "reach",
    start: str = "still",
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
    episodes: int = 10,
    seed: int = 0,
    force: bool = False,
    json: Path | None = None,
) -> None:
    """Record episodes of the scripted demonstrator into a Minari dataset.

    Args:
        out: the folder of the dataset. Minari's own commands find it in the folder that
            MINARI_DATASETS_PATH names if its name ends in a version, as `demos-v0` does.
        robot: a shipped robot's name, or a path ending in .toml.
        frame_skip: how many simulation steps each command is held for; by default the robot's own
            number, 1 for the paper's robot.
        backend: the engine.
        space: the operation space of the targets: anchor, floating, spatter, workspace, a map
            (.npz) or debris (.stl, .obj, .ply, .glb).
        task: reach, precise, quiet, capture, capture-drift, capture-tumble, follow-line,
            follow-circle or follow-random.
        start: how episodes begin: still, moving or anywhere (`cdcsr.tasks.starts`).
        threshold: the tip is on the target within this distance, in m; by default the robot's own.
        seconds: how long an episode may take, in s; by default the robot's own.
        radius: of the balls of Floating or Spatter, in m; by default the robot's own.
        episodes: how many successful episodes.
        seed: seed of the targets.
        force: replace an existing folder.
        json: also write the summary to this file.
    """
    from cdcsr.envs.gym_env import TaskVectorEnv
    from cdcsr.files import write_json
    from cdcsr.folders import new_folder
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.arguments import MOST_COPIES, check_count
    from cdcsr.tasks.feasible import adjusted, check_targets
    from controllers import demonstrations
    from controllers.dataset_files import dataset_id
    from controllers.jacobian import JacobianController

    check_count("episodes", episodes, MOST_COPIES)
    name = dataset_id(out)
    description = adjusted(load_robot(robot), task, [space], threshold, seconds, radius)
    with new_folder(out, "demonstrations", force) as folder:
        options = {"frame_skip": frame_skip, "task": task, "autoreset_mode": "Disabled"}
        env = TaskVectorEnv(episodes, description, backend, space, start=start, **options)
        check_targets(description, env.task, env.space, bent=start == "anywhere")
        controller = JacobianController(env.robot)
        recorded, failed, diverged = demonstrations.record(controller, env, episodes, seed)
        demonstrations.save(folder, recorded, env, controller.name, name)
        env.close()
    summary = {
        "out": str(out),
        "robot": env.robot.name,
        "task": env.task.name,
        "backend": backend,
        "space": space,
        "start": env.start,
        "seed": seed,
        **_numbers(recorded, failed, env.frame_skip),
        "diverged": diverged,
    }
    print(
        "{episodes} demonstrations of {robot} in {backend} "
        "({task}, {space}, start {start}, seed {seed}): "
        "{steps} steps, {length_mean:.1f} on average, {failed} failed and drawn anew -> {out}"
        "".format(**summary)
    )
    if diverged:
        print(f"{diverged} of the failed episodes diverged")
    if json is not None:
        write_json(json, summary)


def _numbers(recorded: list[Episode], failed: int, frame_skip: int) -> dict[str, object]:
    """Return the numbers of the summary; lengths are in simulation steps."""
    lengths = [frame_skip * episode.length for episode in recorded]
    return {
        "episodes": len(recorded),
        "failed": failed,
        "steps": sum(lengths),
        "length_mean": sum(lengths) / len(lengths),
        "targets": [episode.target.tolist() for episode in recorded],
    }
