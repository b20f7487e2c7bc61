"""The commands `cdcsr demonstrate` and `cdcsr replay`."""

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
    force: bool = False,
    json: Path | None = None,
) -> None:
    """Record the scripted Jacobian controller into a Minari dataset.

    Args:
        out: the folder of the dataset.
        backend: the engine.
        space: where targets are drawn: anchor, floating or spatter.
        episodes: how many successful episodes.
        seed: of the targets.
        robot: a shipped robot's name, or a path ending in .toml.
        frame_skip: simulation steps each command is held for.
        force: replace an existing folder.
        json: also write the summary to this file.
    """
    from cdcsr.envs import ReachVectorEnv
    from cdcsr.errors import CdcsrError
    from cdcsr.files import new_folder, write_json
    from controllers import demonstrations
    from controllers.jacobian import JacobianController

    if episodes < 1:
        raise CdcsrError(f"episodes must be at least 1, not {episodes}.")
    with new_folder(out, force) as folder:
        env = ReachVectorEnv(episodes, robot, backend, space, frame_skip=frame_skip, autoreset_mode="Disabled")
        controller = JacobianController(env.robot)
        recorded, failed = demonstrations.record(controller, env, episodes, seed)
        demonstrations.save(folder, recorded, env, controller.name, out.name)
        env.close()
    lengths = [episode.length for episode in recorded]
    summary = {
        "out": str(out),
        "robot": env.robot.name,
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
        f"{len(recorded)} demonstrations of {env.robot.name} in {backend} ({space}, seed {seed}): "
        f"{sum(lengths)} steps, {summary['length_mean']:.1f} on average, {failed} failed and drawn anew -> {out}"
    )
    if json is not None:
        write_json(json, summary)


def replay(
    dataset: Path,
    /,
    *,
    backend: str = "all",
    robot: str = "paper",
    json: Path | None = None,
) -> None:
    """Replay recorded commands open-loop in each engine, and show how far the tips come apart.

    Args:
        dataset: a folder made by `cdcsr demonstrate`.
        backend: an engine, or all.
        robot: the robot of the dataset: a shipped one's name, or a path ending in .toml.
        json: also write the distances to this file.
    """
    from cdcsr.files import write_json
    from cdcsr.robot import load_robot
    from cdcsr.simulation import backend_names, load_backend
    from controllers import demonstrations
    from controllers.replay import replay as run

    description = load_robot(robot)
    episodes = demonstrations.load(dataset, description.fingerprint)
    backends = backend_names() if backend == "all" else [backend]
    for name in backends:
        load_backend(name)
    results = [run(description, name, episodes).as_dict() for name in backends]
    print(f"{len(episodes)} recorded episodes, replayed without feedback; distance of the tip from the recording:")
    for result in results:
        print(
            f"  {result['backend']:<10} mean {result['mean_mm']:.3f} mm, worst episode "
            f"{result['mean_of_worst_episode_mm']:.3f} mm, largest {result['largest_mm']:.3f} mm"
        )
    if json is not None:
        write_json(json, results)
