"""Find the controllers that a user names, measure them, and show the result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.robot.description import Robot
    from controllers.controller import Controller
    from training.measure.transfer_matrix import Cell


def report_cells(
    controllers: list[Controller],
    robot: Robot,
    backend: str,
    spaces: list[str],
    episodes: int,
    seed: int | None,
    json: Path | None,
    plot: Path | None,
    disturbances: Disturbances | None,
    task: str,
    start: str,
    numbers: tuple[float | None, float | None, float | None] = (None, None, None),
) -> None:
    """Measure controllers, print the table, write the JSON file and draw the picture.

    Args:
        controllers: what is measured.
        robot: the description that they all act on.
        backend: an engine, or all.
        spaces: where targets lie.
        episodes: how many episodes in each cell.
        seed: seed of the targets; None for the held-out ones.
        json: where results are written, if anywhere.
        plot: where the picture is drawn, if anywhere.
        disturbances: between controllers and robot, if any.
        task: the name of the task.
        start: the states in which episodes begin.
        numbers: threshold in [m], seconds of an episode and radius of the space in [m]; None for
            the robot's own.
    """
    from cdcsr.files import refuse_unwritable, write_json
    from cdcsr.simulation.engines import chosen_backends
    from cdcsr.tasks.feasible import adjusted
    from training.config.seeds import TEST_SEED
    from training.measure.transfer_matrix import (
        disagreements,
        diverged,
        format_table,
        other_targets,
    )
    from training.measure.transfer_matrix import transfer as measure

    def progress(cell: Cell) -> None:
        rate = f"{cell.result.rate:.2f}"
        print(f"{cell.controller} in {cell.backend}, {cell.space}: {rate}", flush=True)

    if plot is not None:
        refuse_unwritable(plot)
    robot = adjusted(robot, task, spaces, *numbers)
    for controller in controllers:
        check_spaces(controller, robot, task, spaces, start)
    backends, seed = chosen_backends(backend, robot), TEST_SEED if seed is None else seed
    cells = measure(
        controllers, robot, backends, spaces, episodes, seed, disturbances, task, start, progress
    )
    print(f"\n{task}, start {start}: {episodes} episodes in each cell, target seed {seed}\n")
    print(format_table(cells))
    for sentence in (*other_targets(cells), *diverged(cells)):
        print(sentence)
    if json is not None:
        found = {
            "task": task,
            "start": start,
            "seed": seed,
            "cells": [cell.as_dict() for cell in cells],
            "disagreements": [pair.as_dict() for pair in disagreements(cells)],
        }
        write_json(json, found)
    if plot is not None:
        _draw(cells, robot, plot)


def check_spaces(
    controller: Controller, robot: Robot, task: str, spaces: list[str], start: str
) -> None:
    """Check that the targets of a controller make a task of it in every space.

    Raises:
        CdcsrError: in one of them targets are reached at once, or are out of reach.
    """
    from cdcsr.tasks.catalogue import make_task
    from cdcsr.tasks.feasible import check_targets
    from cdcsr.tasks.spaces import make_space

    for name in spaces:
        space = make_space(name, robot, controller.centers)
        check_targets(robot, make_task(task, robot), space, bent=start == "anywhere")


def _draw(cells: list[Cell], robot: Robot, plot: Path) -> None:
    """Draw the targets of each cell in a panel of its own."""
    from cdcsr.simulation.engines import engine_title
    from training.plots.targets import draw_targets

    several = len({cell.space for cell in cells}) > 1
    panels = {
        f"{cell.controller} in {engine_title(cell.backend)}"
        + (f", {cell.space}" if several else ""): cell.result
        for cell in cells
    }
    draw_targets(panels, robot, plot)
    print(f"\ndrawn to {plot}")


def set_threads() -> None:
    """Let torch compute in one thread, so that the same bits come out on every machine."""
    try:
        import torch
    except ModuleNotFoundError:
        return  # policies say what they need

    torch.set_num_threads(1)


def find_controller(name: str, robot: Robot) -> Controller:
    """Return the controller that a user names; torch then computes in one thread.

    Args:
        name: a scripted controller (jacobian, nearest, nearest:FOLDER), `package.module:Object`, a
            `.zip` file of stable-baselines3, the folder of a policy or a run, or the name of a
            shipped policy.
        robot: the robot that it is to control; a policy brings its own.

    Raises:
        CdcsrError: there is no such controller, or it cannot be loaded.
    """
    from cdcsr.files import note
    from controllers.registry import SCRIPTED, scripted_controller
    from controllers.stable_baselines import StableBaselines

    if name.partition(":")[0] not in SCRIPTED:  # torch is an import of seconds
        set_threads()
    scripted = scripted_controller(name, robot)
    if scripted is not None:
        return scripted
    if name.endswith(".zip"):
        return StableBaselines(name)
    from training.policy import find_policy  # needs torch
    from training.run.train_options import is_unfinished

    policy = find_policy(name, SCRIPTED)
    done = policy.card.get("unfinished")
    if isinstance(done, dict) or is_unfinished(Path(name)):  # older cards do not tell
        stage = ""
        if isinstance(done, dict):
            stage = f", from update {done.get('update')} of {done.get('of')}"
        note(f"The policy {name} is unfinished{stage}; the options of its run resume the training.")
    return policy


def robot_of(controller: Controller, robot: Robot, asked: bool) -> Robot:
    """Return the robot that a controller is for: a policy's own, else the one asked for.

    Args:
        controller: the controller.
        robot: the robot asked for, or the default.
        asked: whether the user asked for it.

    Raises:
        CdcsrError: another robot than the policy's own was asked for.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import differences

    if controller.space is None:
        return robot
    from training.policy import Policy  # needs torch

    if not isinstance(controller, Policy):
        return robot
    own = controller.robot
    if asked and robot.fingerprint != own.fingerprint:
        raise CdcsrError(
            f"The policy {controller.name!r} is for its own robot {own.name!r}, which differs from "
            f"{robot.name!r} ({differences(own, robot)}); leave --robot out, or train a policy for "
            "that robot. `cdcsr sweep` shows how far a plant may differ."
        )
    return own
