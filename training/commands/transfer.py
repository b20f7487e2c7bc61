"""`cdcsr transfer`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdcsr.robot.description import Robot
    from cdcsr.robot.scale import Scale
    from controllers.controller import Controller


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
        space: anchor, floating, spatter, workspace, a map (.npz), debris (.stl, .obj, .ply, .glb);
            or all, which is the first three.
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
    from cdcsr.robot.description import load_robot
    from cdcsr.tasks.spaces import SPACES
    from training.commands.measured import find_controller, report_cells

    _check_names(policies)
    asked = load_robot(robot or "paper")
    controllers = [find_controller(name, asked) for name in policies]
    learned = [one for one in controllers if one.space is not None]
    acted_on = _one_robot(learned, asked, robot is not None)
    if acted_on.fingerprint != asked.fingerprint:  # scripted controllers act on that robot too
        controllers = [
            one if one.space is not None else find_controller(name, acted_on)
            for name, one in zip(policies, controllers, strict=True)
        ]
    names = Counter(one.name for one in controllers)
    for path, one in zip(policies, controllers, strict=True):
        if names[one.name] > 1:  # such as runs with the same options in different folders
            one.name = f"{one.name} ({path})"
    if learned:
        from training.policy import Policy  # needs torch

        _check_scales([one.robot.scale for one in learned if isinstance(one, Policy)])
    report_cells(
        controllers,
        acted_on,
        backend,
        [*SPACES] if space == "all" else [space],
        episodes,
        seed,
        json,
        plot,
        None,
        task or _agreed([one.task for one in learned], "for different tasks", "--task") or "reach",
        start
        or _agreed([one.start for one in learned], "from different starts", "--start")
        or "still",
        (threshold, seconds, radius),
    )


def _check_names(policies: list[str]) -> None:
    """Check that controllers are named, each once."""
    from cdcsr.errors import CdcsrError

    if not policies:
        raise CdcsrError("No policy is given; name at least one folder of a policy or a run.")
    if len(set(policies)) < len(policies):
        raise CdcsrError(f"A controller is given twice: {', '.join(policies)}; name each once.")


def _one_robot(learned: list[Controller], asked: Robot, named: bool) -> Robot:
    """Return the robot of all policies, or the one asked for if there is no policy.

    Raises:
        CdcsrError: the policies are for different robots, or for another than the one asked for.
    """
    from cdcsr.errors import CdcsrError
    from training.commands.measured import robot_of

    robots = [robot_of(one, asked, named) for one in learned] or [asked]
    if len({one.fingerprint for one in robots}) > 1:
        raise CdcsrError(
            f"The policies are for different robots ({', '.join(one.name for one in robots)}); "
            "measure those of each robot by themselves."
        )
    return robots[0]


def _agreed(values: list[str], differ: str, option: str) -> str | None:
    """Return what all policies were trained with; None if there is no policy.

    Raises:
        CdcsrError: they were trained with several; the option chooses one.
    """
    from cdcsr.errors import CdcsrError

    found = sorted(set(values))
    if len(found) > 1:
        raise CdcsrError(
            f"The policies were trained {differ} ({', '.join(found)}); choose one with {option}."
        )
    return found[0] if found else None


def _check_scales(scales: list[Scale]) -> None:
    """Check that all policies were trained with the same numbers of the task."""
    from cdcsr.errors import CdcsrError

    if any(scale != scales[0] for scale in scales):
        raise CdcsrError(
            "The policies were trained with different numbers of the task (threshold, seconds, "
            "radius or [scale]); evaluate them one by one."
        )
