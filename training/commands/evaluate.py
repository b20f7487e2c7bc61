"""`cdcsr evaluate`."""

from __future__ import annotations

from pathlib import Path


def evaluate(
    policy: str,
    /,
    *,
    robot: str | None = None,
    backend: str = "all",
    space: str | None = None,
    task: str | None = None,
    start: str | None = None,
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
    episodes: int = 100,
    seed: int | None = None,
    action_noise: float = 0.0,
    base_noise: float = 0.0,
    packet_loss: float = 0.0,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Measure one controller on held-out targets.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, "jacobian" (the scripted
            demonstrator), "nearest" (replays the nearest demonstration), package.module:Object (a
            controller of your own), or a .zip of stable-baselines3.
        robot: the robot; by default the policy's own, or else "paper". A policy is refused on
            another robot than its own.
        backend: an engine, or all.
        space: anchor, floating, spatter, workspace, a map (.npz) or debris (.stl, .obj, .ply,
            .glb); by default that of the training.
        task: the task; by default the one it was trained for.
        start: how episodes begin: still, moving or anywhere (`cdcsr.tasks.starts`); by default as
            in the training.
        threshold: the tip is on the target within this distance, in m; by default as in the
            training, or the robot's own; so too the next two.
        seconds: how long an episode may take, in s.
        radius: of the balls of Floating or Spatter, in m.
        episodes: how many episodes, run as one batch.
        seed: seed of the targets; by default the one that nothing is tuned on.
        action_noise: standard deviation of noise on the commands, in [m] of set-point.
        base_noise: standard deviation of noise on the observed base position, in [m].
        packet_loss: probability that an observation is lost.
        json: also write the results, each episode included, to this file.
        plot: also draw which targets are reached, in a panel for each cell, to this PNG.
    """
    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.robot.description import load_robot
    from training.commands.measured import find_controller, report_cells, robot_of

    description = load_robot(robot or "paper")
    controller = find_controller(policy, description)
    report_cells(
        [controller],
        robot_of(controller, description, robot is not None),
        backend,
        [space or controller.space or "anchor"],
        episodes,
        seed,
        json,
        plot,
        Disturbances(action_noise, base_noise, packet_loss),
        task or controller.task,
        start or controller.start,
        (threshold, seconds, radius),
    )
