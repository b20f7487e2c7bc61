"""The commands that measure: `cdcsr evaluate` and `cdcsr transfer`; and the main job, `cdcsr demo`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cdcsr.robot import Robot
    from controllers.controller import Controller


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
    from cdcsr.disturbances import Disturbances

    _set_threads()
    controller, description = find_controller(policy, robot)
    spaces = [space or trained_space(controller)]
    _report([controller], description, backend, spaces, episodes, seed, json, plot,
            Disturbances(action_noise, base_noise, packet_loss), task or trained_task(controller))  # fmt: skip


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
    from cdcsr.robot import load_robot
    from cdcsr.spaces import SPACES
    from controllers.jacobian import JacobianController
    from training.policy import find_policy

    _set_threads()
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
    controllers: list[Controller] = [found.get(name) or JacobianController(robot) for name in policies]
    spaces = list(SPACES) if space == "all" else [space]
    tasks = [task] if task else sorted({policy.task for policy in learned}) or ["reach"]
    if len(tasks) > 1:
        raise CdcsrError(f"The policies were trained for different tasks ({', '.join(tasks)}); choose one with --task.")
    _report(controllers, robot, backend, spaces, episodes, seed, json, plot, None, tasks[0])


def demo(out: Path, minutes: float = 8.0, json: Path | None = None) -> None:
    """Build, demonstrate, train, and measure the transfer between engines: the whole path, in one folder.

    Builds the paper's robot for both engines, records ten demonstrations, trains BC and BATD3 in MuJoCo, measures
    both and the demonstrator on the same held-out targets in both engines, and draws a learning curve, the targets
    and a video. Stopped at any point, the same command goes on from there.

    Args:
        out: the folder of everything.
        minutes: of training, at most. With more, a demo whose training ran out of them goes on.
        json: also write the results, each episode included, to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from training.demo import Amounts, run_demo

    if not minutes > 0:
        raise CdcsrError(f"minutes must be positive, not {minutes:g}.")
    summary = run_demo(out, Amounts(minutes))
    if json is not None:
        write_json(json, summary)


def _report(
    controllers: list[Controller],
    robot: Robot,
    backend: str,
    spaces: list[str],
    episodes: int,
    seed: int | None,
    json: Path | None,
    plot: Path | None,
    disturbances: object,
    task: str,
) -> None:
    """Measure, print the table, write the JSON file and draw the picture."""
    from cdcsr.disturbances import Disturbances
    from cdcsr.files import write_json
    from cdcsr.simulation import chosen_backends
    from training.seeds import TEST_SEED
    from training.transfer import Cell, disagreements, format_table, other_targets
    from training.transfer import transfer as measure

    backends = chosen_backends(backend)
    assert disturbances is None or isinstance(disturbances, Disturbances)

    def progress(cell: Cell) -> None:
        print(f"{cell.controller} in {cell.backend}, {cell.space}: {cell.result.rate:.2f}", flush=True)

    seed = TEST_SEED if seed is None else seed
    cells = measure(controllers, robot, backends, spaces, episodes, seed, disturbances, task, progress)
    print(f"\n{task}: {episodes} episodes in each cell, target seed {seed}\n")
    print(format_table(cells))
    for sentence in other_targets(cells):
        print(sentence)
    if json is not None:
        pairs = [pair.as_dict() for pair in disagreements(cells)]
        write_json(
            json, {"task": task, "seed": seed, "cells": [cell.as_dict() for cell in cells], "disagreements": pairs}
        )
    if plot is not None:
        from training.figures import targets_picture
        from training.style import engine_title

        panels = {
            f"{cell.controller} in {engine_title(cell.backend)}" + (f", {cell.space}" if len(spaces) > 1 else ""): cell
            for cell in cells
        }
        targets_picture({title: cell.result for title, cell in panels.items()}, robot, plot)
        print(f"\ndrawn to {plot}")


def _set_threads() -> None:
    import torch

    torch.set_num_threads(1)


def trained_task(controller: Controller) -> str:
    """The task of a policy; that of a scripted controller is to reach."""
    from training.policy import Policy

    return controller.task if isinstance(controller, Policy) else "reach"


def trained_space(controller: Controller) -> str:
    from training.policy import Policy

    return str(controller.card["space"]) if isinstance(controller, Policy) else "anchor"


def find_controller(name: str, robot: str) -> tuple[Controller, Robot]:
    """The controller of that name or folder, and the robot it is for."""
    from cdcsr.robot import load_robot
    from controllers.jacobian import JacobianController
    from training.policy import find_policy

    if name == JacobianController.name:
        description = load_robot(robot)
        return JacobianController(description), description
    policy = find_policy(name)
    return policy, policy.robot


def bench(
    sections: tuple[Literal["environment", "model", "growth", "arms", "trainer"], ...] = (),
    /,
    *,
    json: Path | None = None,
    plot: Path | None = None,
    peers: str | None = None,
) -> None:
    """Measure speed and memory, times as ratios within one process, the machine's own floor beside them.

    Needs the development dependencies (stable-baselines3), and a system with the `resource` module for memory.

    Args:
        sections: which measurements; by default all.
        json: also write the numbers to this file.
        plot: also draw how the cost of a step grows with the robot, into this folder.
        peers: an interpreter that has gym-softrobot and sbx-rl; by default this one, if it has.
    """
    from training.benchmarks import Benchmarks

    Benchmarks(peers, plot).run(sections, json)
