"""`cdcsr sweep`: how wrong the second plant may be."""

from __future__ import annotations

from pathlib import Path


def sweep(
    policy: str,
    /,
    *,
    backend: str = "all",
    space: str | None = None,
    task: str | None = None,
    axis: tuple[str, ...] = ("all",),
    episodes: int = 100,
    seed: int | None = None,
    robot: str = "paper",
    json: Path | None = None,
    csv: Path | None = None,
) -> None:
    """Measure a policy on plants that are ever more wrong, until success halves.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, or "jacobian" for the demonstrator.
        backend: an engine, or all.
        space: anchor, floating, spatter or workspace; by default the one the policy was trained in.
        task: what it is to do; by default what it was trained for.
        axis: in what the plant is wrong: names of axes, or all.
        episodes: at each level, run as one batch.
        seed: of the targets; by default the one that nothing is tuned on.
        robot: the robot of the scripted demonstrator; a policy brings its own.
        json: also write rates, halving levels, and the episodes that end differently, to this file.
        csv: also write every episode to this file.
    """
    import torch

    from cdcsr.files import write_json, write_text
    from cdcsr.simulation.engines import chosen_backends
    from training.commands.measured import find_controller, trained_space, trained_task
    from training.config.seeds import TEST_SEED
    from training.measure.plant_axes import find_axes
    from training.measure.plant_sweep import (
        Point,
        Row,
        between_engines,
        between_plants,
        format_sweep,
        halvings,
    )
    from training.measure.plant_sweep import sweep as measure

    torch.set_num_threads(1)
    axes, backends = find_axes(axis), chosen_backends(backend)
    controller, description = find_controller(policy, robot)
    space, task = space or trained_space(controller), task or trained_task(controller)
    seed = TEST_SEED if seed is None else seed

    def progress(point: Point) -> None:
        told = point.diverged if point.result is None else f"{point.result.rate:.2f}"
        print(f"{point.axis.name} {point.level:g} in {point.backend}: {told}", flush=True)

    lines: list[list[Point]] = []
    nominal: dict[str, Point] = {}
    for each in axes:
        for engine in backends:
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
                progress,
                task,
            )
            nominal[engine] = line[0]
            lines.append(line)
    points = [point for line in lines for point in line]
    print(
        f"\n{controller.name}, {task} in {space}: {episodes} episodes at each level, target seed {seed}; nominal ",
        end="",
    )
    print(
        ", ".join(
            f"{engine} {p.result.rate:.2f}" for engine, p in nominal.items() if p.result is not None
        )
    )
    print("\n" + format_sweep(points))
    apart = between_engines(list(nominal.values()))
    for difference in map(lambda d: d.as_dict(), apart):
        target = ", ".join(f"{x:.3f}" for x in difference["target"])
        where = f"succeeds only in {difference['succeeds']['backend']}"
        print(
            f"nominal, episode {difference['episode']}, target ({target}): {where}; {difference['reading']}"
        )
    if csv is not None:
        table = [Row._fields, *(row for point in points for row in point.rows)]
        write_text(csv, "".join(",".join(map(str, row)) + "\n" for row in table))
    if json is not None:
        write_json(
            json,
            {
                "policy": controller.name,
                "task": task,
                "space": space,
                "seed": seed,
                "episodes": episodes,
                "points": [point.as_dict() for point in points],
                "halvings": [halving.as_dict() for line in lines for halving in halvings(line)],
                "between_engines": [difference.as_dict() for difference in between_engines(points)],
                "between_plants": [difference.as_dict() for difference in between_plants(points)],
            },
        )
