"""Find the controllers that a user names, measure them, and show the result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdcsr.robot.description import Robot
    from controllers.controller import Controller


def report_cells(
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
    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.files import write_json
    from cdcsr.simulation.engines import chosen_backends
    from training.config.seeds import TEST_SEED
    from training.measure.transfer_matrix import Cell, disagreements, format_table, other_targets
    from training.measure.transfer_matrix import transfer as measure

    backends = chosen_backends(backend)
    assert disturbances is None or isinstance(disturbances, Disturbances)

    def progress(cell: Cell) -> None:
        print(
            f"{cell.controller} in {cell.backend}, {cell.space}: {cell.result.rate:.2f}", flush=True
        )

    seed = TEST_SEED if seed is None else seed
    cells = measure(
        controllers, robot, backends, spaces, episodes, seed, disturbances, task, progress
    )
    print(f"\n{task}: {episodes} episodes in each cell, target seed {seed}\n")
    print(format_table(cells))
    for sentence in other_targets(cells):
        print(sentence)
    if json is not None:
        pairs = [pair.as_dict() for pair in disagreements(cells)]
        write_json(
            json,
            {
                "task": task,
                "seed": seed,
                "cells": [cell.as_dict() for cell in cells],
                "disagreements": pairs,
            },
        )
    if plot is not None:
        from cdcsr.simulation.engines import engine_title
        from training.plots.targets import draw_targets

        panels = {
            f"{cell.controller} in {engine_title(cell.backend)}"
            + (f", {cell.space}" if len(spaces) > 1 else ""): cell
            for cell in cells
        }
        draw_targets({title: cell.result for title, cell in panels.items()}, robot, plot)
        print(f"\ndrawn to {plot}")


def set_threads() -> None:
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
    from cdcsr.robot.description import load_robot
    from controllers.jacobian import JacobianController
    from training.policy import find_policy

    if name == JacobianController.name:
        description = load_robot(robot)
        return JacobianController(description), description
    policy = find_policy(name)
    return policy, policy.robot
