"""The commands `cdcsr demonstrate`, `cdcsr replay`, `cdcsr workspace` and `cdcsr parity`."""

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
    """Record the scripted Jacobian controller into a Minari dataset.

    Args:
        out: the folder of the dataset.
        backend: the engine.
        space: where targets are drawn: anchor, floating, spatter or workspace.
        episodes: how many successful episodes.
        seed: of the targets.
        robot: a shipped robot's name, or a path ending in .toml.
        frame_skip: simulation steps each command is held for.
        task: reach, precise, quiet, capture, capture-drift, capture-tumble, follow-line, -circle or -random.
        force: replace an existing folder.
        json: also write the summary to this file.
    """
    from cdcsr.envs import TaskVectorEnv
    from cdcsr.errors import CdcsrError
    from cdcsr.files import new_folder, write_json
    from controllers import demonstrations
    from controllers.jacobian import JacobianController

    if episodes < 1:
        raise CdcsrError(f"episodes must be at least 1, not {episodes}.")
    with new_folder(out, force) as folder:
        env = TaskVectorEnv(
            episodes, robot, backend, space, frame_skip=frame_skip, task=task, autoreset_mode="Disabled"
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
        f"{len(recorded)} demonstrations of {env.robot.name} in {backend} ({env.task.name}, {space}, seed {seed}): "
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
    frame_skip: int = 1,
    json: Path | None = None,
) -> None:
    """Replay recorded commands open-loop in each engine, and show how far the tips come apart.

    Args:
        dataset: a folder made by `cdcsr demonstrate`.
        backend: an engine, or all.
        robot: the robot of the dataset: a shipped one's name, or a path ending in .toml.
        frame_skip: simulation steps each command was held for in it.
        json: also write the distances to this file.
    """
    from cdcsr.files import write_json
    from cdcsr.robot import load_robot
    from cdcsr.simulation import chosen_backends
    from controllers import demonstrations
    from controllers.replay import replay as run

    description = load_robot(robot)
    episodes = demonstrations.load(dataset, description.fingerprint, frame_skip)
    results = [run(description, name, episodes, frame_skip).as_dict() for name in chosen_backends(backend)]
    print(f"{len(episodes)} recorded episodes, replayed without feedback; distance of the tip from the recording:")
    for result in results:
        print(
            f"  {result['backend']:<10} mean {result['mean_mm']:.3f} mm, worst episode "
            f"{result['mean_of_worst_episode_mm']:.3f} mm, largest {result['largest_mm']:.3f} mm"
        )
    if json is not None:
        write_json(json, results)


def workspace(
    robot: str,
    /,
    *,
    out: Path,
    backend: str = "mujoco",
    spacing: float = 0.05,
    frame_skip: int = 5,
    plot: Path | None = None,
    json: Path | None = None,
) -> None:
    """Map what the scripted Jacobian controller reaches in an episode, all around the arm.

    The map is an operation space: give its file as --space to other commands.

    Args:
        robot: a shipped robot's name, or a path ending in .toml.
        out: the map, an .npz file.
        backend: the engine.
        spacing: of the grid of targets that are tried, in m.
        frame_skip: simulation steps each command is held for; fewer take longer.
        plot: also draw the map into this PNG file.
        json: also write the summary to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.robot import load_robot
    from controllers.workspace import compute_workspace, draw_workspace

    if out.suffix != ".npz":
        raise CdcsrError(f"A map is an .npz file, not {out.name!r}.")
    if plot is not None and plot.suffix != ".png":
        raise CdcsrError(f"The picture of a map is a .png file, not {plot.name!r}.")
    if not spacing > 0:
        raise CdcsrError(f"spacing must be positive, not {spacing:g}.")
    description = load_robot(robot)
    counts = {"tried": 0, "reached": 0}

    def progress(tried: int, reached: int) -> None:
        counts.update(tried=tried, reached=reached)
        print(f"\r{tried} targets tried, {reached} reached", end="", flush=True)

    found = compute_workspace(description, backend, spacing, frame_skip, progress)
    print()
    found.save(out)
    print(f"{len(found.cells)} cells of edge {spacing:g} m around {description.name} -> {out}")
    if plot is not None:
        draw_workspace(found, description, plot)
    if json is not None:
        summary = {"out": str(out), "robot": description.name, "backend": backend, "spacing": spacing, **counts}
        write_json(json, {**summary, "cells": len(found.cells)})


def parity(
    robot: str,
    /,
    *,
    reference: str = "mujoco",
    backend: str = "all",
    episodes: int = 4,
    seed: int = 0,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Measure how far apart the engines are on a robot: one state, one step, open loop.

    Each level has tolerances. If one is broken, everything is still measured and written; then the first check
    that failed is named and the exit code is 1.

    Args:
        robot: a shipped robot, or a path ending in .toml.
        reference: the engine that the others are compared with.
        backend: the engine to compare with it, or all that are installed.
        episodes: how many episodes of the demonstrator, and as many of random commands.
        seed: of states, targets and random commands.
        json: also write every figure and check to this file.
        plot: also draw the figures into this folder.
    """
    from cdcsr.errors import CdcsrError, CheckFailed
    from cdcsr.files import write_json
    from cdcsr.robot import load_robot
    from cdcsr.simulation import backend_names, load_backend
    from controllers.parity.study import measure, show

    if episodes < 1:
        raise CdcsrError(f"episodes must be at least 1, not {episodes}.")
    if seed < 0:
        raise CdcsrError(f"seed must not be negative, found {seed}.")
    description = load_robot(robot)
    engines = {reference: load_backend(reference)}
    others = backend_names() if backend == "all" else [backend]
    engines |= {name: load_backend(name) for name in others if name != reference}
    if len(engines) < 2:
        raise CdcsrError(f"There is no engine to compare {reference!r} with; installed: {', '.join(backend_names())}.")
    result = measure(description, engines, episodes, seed, progress=True)
    print(show(result))
    if json is not None:
        write_json(json, result.as_dict())
    if plot is not None:
        from controllers.parity.figures import draw

        print("figures: " + ", ".join(str(path) for path in draw(result, plot)))
    if result.failed:
        raise CheckFailed(f"{len(result.failed)} parity checks failed, first: {result.failed[0]}.")
