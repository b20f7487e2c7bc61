"""`cdcsr sweep`: how far a plant may differ from the model."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from training.measure.plant_sweep import Point


def sweep(
    policy: str,
    /,
    *,
    axis: tuple[str, ...] = ("all",),
    backend: str = "all",
    space: str | None = None,
    task: str | None = None,
    start: str | None = None,
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
    episodes: int = 100,
    seed: int | None = None,
    robot: str | None = None,
    json: Path | None = None,
    csv: Path | None = None,
) -> None:
    """Measure a controller on plants that differ ever more from the model, until success halves.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, or another controller that
            `cdcsr evaluate` takes.
        axis: the model errors to sweep: names of axes, or all.
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
        episodes: how many episodes at each level, run as one batch.
        seed: seed of the targets; by default the one that nothing is tuned on.
        robot: the robot; by default the policy's own, or else "paper". A policy is refused on
            another robot than its own.
        json: also write rates, halving levels, and the episodes that end differently, to this file.
        csv: also write every episode to this file.
    """
    from cdcsr.files import write_json, write_text
    from cdcsr.tables import csv_text
    from training.measure.plant_sweep import Row
    from training.measure.sweep_table import as_dict, format_sweep

    numbers = (threshold, seconds, radius)
    head, lines = _measure(
        policy, backend, space, task, start, numbers, axis, episodes, seed, robot
    )
    points = [point for line in lines for point in line]
    nominal = list({line[0].backend: line[0] for line in lines}.values())
    rates = ", ".join(f"{point.backend} {_rate(point)}" for point in nominal)
    print(
        "\n{policy}, {task} in {space}, start {start}: {episodes} episodes at each level, "
        "target seed {seed}; nominal {rates}\n".format(**head, rates=rates)
    )
    print(format_sweep(points))
    _show_differences(nominal)
    if csv is not None:
        write_text(csv, csv_text(Row._fields, [row for point in points for row in point.rows]))
    if json is not None:
        write_json(json, {**head, **as_dict(lines)})


def _measure(
    policy: str,
    backend: str,
    space: str | None,
    task: str | None,
    start: str | None,
    numbers: tuple[float | None, float | None, float | None],
    axis: tuple[str, ...],
    episodes: int,
    seed: int | None,
    robot: str | None,
) -> tuple[dict[str, object], list[list[Point]]]:
    """Return what is swept, and the points of each axis in each engine."""
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.engines import chosen_backends
    from cdcsr.tasks.feasible import adjusted
    from training.commands.measured import check_spaces, find_controller, robot_of
    from training.config.seeds import TEST_SEED
    from training.measure.plant_axes import find_axes
    from training.measure.plant_sweep import sweep as measure

    axes, description = find_axes(axis), load_robot(robot or "paper")
    backends = chosen_backends(backend, description)
    controller = find_controller(policy, description)
    description = robot_of(controller, description, robot is not None)
    space, task = space or controller.space or "anchor", task or controller.task
    start = start or controller.start
    description = adjusted(description, task, [space], *numbers)
    axes = [each.on(description) for each in axes]
    check_spaces(controller, description, task, [space], start)
    seed = TEST_SEED if seed is None else seed
    lines: list[list[Point]] = []
    nominal: dict[str, Point] = {}
    for each, engine in product(axes, backends):
        line = measure(
            controller,
            description,
            engine,
            space,
            each,
            None,
            episodes,
            seed,
            nominal.get(engine),
            _progress,
            task,
            start,
        )
        nominal[engine] = line[0]
        lines.append(line)
    head = {"policy": controller.name, "task": task, "space": space, "start": start}
    return {**head, "seed": seed, "episodes": episodes}, lines


def _rate(point: Point) -> str:
    return point.diverged if point.result is None else f"{point.result.rate:.2f}"


def _progress(point: Point) -> None:
    print(f"{point.axis.name} {point.level:g} in {point.backend}: {_rate(point)}", flush=True)


def _show_differences(nominal: list[Point]) -> None:
    """Print the episodes that end differently in two engines on the nominal plant."""
    from training.measure.sweep_table import between_engines

    for difference in between_engines(nominal):
        target = ", ".join(f"{x:.3f}" for x in difference.target)
        print(
            f"nominal, episode {difference.episode}, target ({target}): succeeds only in "
            f"{difference.better.backend}; {difference.reading}"
        )
