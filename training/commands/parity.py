"""`cdcsr parity`: compare engines."""

from __future__ import annotations

from pathlib import Path


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

    Engines may differ in their scheme and in settings of their own, and the report says by how
    much. Tolerances catch mistakes: all engines must have one equation of motion, and those of the
    ideal cable one limit. If a tolerance is exceeded, the command still measures and writes
    everything; then it names the first check that failed, and its exit code is 1.

    Args:
        robot: a shipped robot, or a path ending in .toml.
        reference: the engine that the others are compared with.
        backend: the engine to compare with it, or "all" that are installed.
        episodes: number of episodes of the demonstrator, and again of random commands.
        seed: seed of states, targets and random commands.
        json: also write every number and check to this file.
        plot: also draw the figures into this folder.
    """
    from backends.parity.report import measure, show
    from backends.parity.trajectories import random_commands
    from cdcsr.errors import CdcsrError, CheckFailed
    from cdcsr.files import refuse_unwritable, write_json
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.arguments import MOST_SEED, check_count
    from cdcsr.simulation.engines import (
        backend_names,
        chosen_backends,
        engine_factory,
        switched_off,
    )
    from training.measure.trajectories import demonstrator_commands

    check_count("episodes", episodes, 1_000)
    check_count("seed", seed, MOST_SEED, least=0)
    if plot is not None:
        refuse_unwritable(plot / "figure.png")
    description = load_robot(robot)
    names = dict.fromkeys([reference, *chosen_backends(backend, description)])
    engines = {name: engine_factory(name) for name in names}
    switches = {
        name: {other: engine_factory(other) for other in switched_off(name)} for name in names
    }
    if len(engines) < 2:
        installed = ", ".join(backend_names())
        raise CdcsrError(
            f"There is no engine to compare {reference!r} with (installed: {installed});"
            " install another, or name one that differs from the reference."
        )
    runs = [
        demonstrator_commands(description, reference, episodes, seed),
        random_commands(description, episodes, seed),
    ]
    result = measure(description, engines, runs, seed, progress=True, switches=switches)
    print(show(result))
    if json is not None:
        write_json(json, result.as_dict())
    if plot is not None:
        from backends.parity.plots import draw

        print("figures: " + ", ".join(str(path) for path in draw(result, plot)))
    if result.failed:
        raise CheckFailed(f"{len(result.failed)} parity checks failed, first: {result.failed[0]}.")
