"""`cdcsr transfer`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path


def transfer(
    policies: list[str],
    /,
    *,
    backend: str = "all",
    space: str = "all",
    start: str | None = None,
    episodes: int = 100,
    seed: int | None = None,
    robot: str | None = None,
    task: str | None = None,
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Measure controllers in every engine and space: the transfer matrix.

    Args:
        policies: folders of policies or runs, names of shipped policies, "jacobian" (the scripted
            demonstrator), "nearest" (replays the nearest demonstration), package.module:Object (a
            controller of your own), or .zip files of stable-baselines3.
        backend: an engine, or all.
        space: anchor, floating, spatter or workspace; or all, which is the first three.
        start: how episodes begin: still, moving or anywhere (`cdcsr.tasks.starts`); by default as
            in the training of all of them.
        episodes: how many episodes in each cell, run as one batch.
        seed: seed of the targets; by default the one that nothing is tuned on.
        task: the task; by default the one that all of them were trained for.
        robot: the robot; by default the policies' own, or else "paper". A policy is refused on
            another robot than its own.
        threshold: the tip is on the target within this distance, in m; by default as in the
            training, or the robot's own; so too the next two.
        seconds: how long an episode may take, in s.
        radius: of the balls of Floating or Spatter, in m.
        json: also write the results, each episode included, to this file.
        plot: also draw which targets are reached, in a panel for each cell, to this PNG.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import load_robot
    from cdcsr.tasks.spaces import SPACES
    from training.commands.measured import find_controller, report_cells, robot_of, set_threads
    from training.policy import Policy

    set_threads()
    if not policies:
        raise CdcsrError("No policy is given; name at least one folder of a policy or a run.")
    if len(set(policies)) < len(policies):
        raise CdcsrError(f"A controller is given twice: {', '.join(policies)}; name each once.")
    asked = load_robot(robot or "paper")
    controllers = [find_controller(name, asked) for name in policies]
    learned = [one for one in controllers if one.space is not None]
    robots = [robot_of(one, asked, robot is not None) for one in learned] or [asked]
    if len({one.fingerprint for one in robots}) > 1:
        raise CdcsrError(
            f"The policies are for different robots ({', '.join(one.name for one in robots)}); "
            "measure those of each robot by themselves."
        )
    if robots[0].fingerprint != asked.fingerprint:  # scripted controllers act on that robot too
        controllers = [
            one if one.space is not None else find_controller(name, robots[0])
            for name, one in zip(policies, controllers, strict=True)
        ]
    names = Counter(one.name for one in controllers)
    for path, one in zip(policies, controllers, strict=True):
        if names[one.name] > 1:  # such as runs with the same options in different folders
            one.name = f"{one.name} ({path})"
    tasks = [task] if task else sorted({one.task for one in learned}) or ["reach"]
    if len(tasks) > 1:
        raise CdcsrError(
            f"The policies were trained for different tasks ({', '.join(tasks)}); "
            "choose one with --task."
        )
    starts: list[str] = [start] if start else sorted({one.start for one in learned})
    if len(starts) > 1:
        raise CdcsrError(
            f"The policies were trained from different starts ({', '.join(starts)}); "
            "choose one with --start."
        )
    scales = [one.robot.scale for one in learned if isinstance(one, Policy)]
    if any(scale != scales[0] for scale in scales):
        raise CdcsrError(
            "The policies were trained with different numbers of the task (threshold, seconds, "
            "radius or [scale]); evaluate them one by one."
        )
    spaces: list[str] = [*SPACES] if space == "all" else [space]
    report_cells(
        controllers,
        robots[0],
        backend,
        spaces,
        episodes,
        seed,
        json,
        plot,
        None,
        tasks[0],
        starts[0] if starts else "still",
        (threshold, seconds, radius),
    )
