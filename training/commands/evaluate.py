"""`cdcsr evaluate`."""

from __future__ import annotations

from pathlib import Path


def evaluate(
    policy: str,
    /,
    *,
    backend: str = "all",
    space: str | None = None,
    task: str | None = None,
    episodes: int = 100,
    seed: int | None = None,
    robot: str = "paper",
    action_noise: float = 0.0,
    base_noise: float = 0.0,
    packet_loss: float = 0.0,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Measure one policy, or the scripted demonstrator, on held-out targets.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, or "jacobian" for the demonstrator.
        backend: an engine, or all.
        space: anchor, floating, spatter or workspace; by default the one the policy was trained in.
        task: what it is to do; by default what it was trained for.
        episodes: how many, run as one batch.
        seed: of the targets; by default the one that nothing is tuned on.
        robot: the robot of the scripted demonstrator; a policy brings its own.
        action_noise: standard deviation of noise on the commands, in [m] of set-point.
        base_noise: standard deviation of noise on the observed base position, in [m].
        packet_loss: probability that an observation is lost.
        json: also write the results, each episode included, to this file.
        plot: also draw which targets are reached, a panel for each cell, to this PNG.
    """
    from cdcsr.envs.disturbances import Disturbances
    from training.commands.measured import (
        find_controller,
        report_cells,
        set_threads,
        trained_space,
        trained_task,
    )

    set_threads()
    controller, description = find_controller(policy, robot)
    spaces = [space or trained_space(controller)]
    report_cells(
        [controller],
        description,
        backend,
        spaces,
        episodes,
        seed,
        json,
        plot,
        Disturbances(action_noise, base_noise, packet_loss),
        task or trained_task(controller),
    )
