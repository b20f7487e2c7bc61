"""`cdcsr transfer`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from controllers.controller import Controller


def transfer(
    policies: list[str],
    /,
    *,
    backend: str = "all",
    space: str = "all",
    task: str | None = None,
    episodes: int = 100,
    seed: int | None = None,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Measure policies in every engine and space: the transfer matrix.

    Args:
        policies: folders of policies or runs, names of shipped policies, or "jacobian" for the demonstrator.
        backend: an engine, or all.
        space: anchor, floating, spatter or workspace; or all, which is the first three.
        task: what they are to do; by default what all of them were trained for.
        episodes: in each cell, run as one batch.
        seed: of the targets; by default the one that nothing is tuned on.
        json: also write the results, each episode included, to this file.
        plot: also draw which targets are reached, a panel for each cell, to this PNG.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import load_robot
    from cdcsr.tasks.spaces import SPACES
    from controllers.jacobian import JacobianController
    from training.commands.measured import report_cells, set_threads
    from training.policy import find_policy

    set_threads()
    if not policies:
        raise CdcsrError("No policy is given; name at least one folder of a policy or a run.")
    if len(set(policies)) < len(policies):
        raise CdcsrError(f"A policy is given twice: {', '.join(policies)}; name each once.")
    found = {name: find_policy(name) for name in policies if name != JacobianController.name}
    learned = list(found.values())
    robot = learned[0].robot if learned else load_robot("paper")
    names = Counter(policy.name for policy in learned)
    for path, policy in found.items():
        if names[policy.name] > 1:  # of runs with the same options in different folders
            policy.name = f"{policy.name} ({path})"
    controllers: list[Controller] = [
        found.get(name) or JacobianController(robot) for name in policies
    ]
    spaces = list(SPACES) if space == "all" else [space]
    tasks = [task] if task else sorted({policy.task for policy in learned}) or ["reach"]
    if len(tasks) > 1:
        raise CdcsrError(
            f"The policies were trained for different tasks ({', '.join(tasks)}); choose one with --task."
        )
    report_cells(controllers, robot, backend, spaces, episodes, seed, json, plot, None, tasks[0])
