"""The sections of `cdcsr bench`: those that the engines bring, and those that fit every engine."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import write_json
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.benchmarks import Measurement, Section, engine_sections
from cdcsr.simulation.engines import backend_names
from training.bench.arms import arms
from training.bench.growth import growth
from training.bench.memory import memory
from training.bench.trainer_speed import trainer
from training.measure.trajectories import demonstrator_commands

_EPISODES, _SEED = 8, 500


def run_sections(
    names: Sequence[str], json: Path | None, plot: Path | None, peers: str | None
) -> None:
    """Measure some sections, or all if none is named, and print each row as it comes.

    Args:
        names: the sections.
        json: file for the values.
        plot: folder for figures.
        peers: an interpreter that has the packages to compare with; by default this one.

    Raises:
        CdcsrError: there is no section of that name.
    """
    sections = all_sections(load_robot("paper"), plot, peers or sys.executable)
    for name in names:
        if name not in sections:
            raise CdcsrError(unknown_choice("section", name, sections))
    values: dict[str, object] = {}
    for name in names or [name for name in sections if name != "gpu" or has_gpu()]:
        print(f"{name}:", flush=True)
        for row in sections[name]():
            number = "     -" if row.value is None else f"{row.value:6.2f}"
            print(f"{number}  {row.what}" + (f" [{row.floor}]" if row.floor else ""), flush=True)
            for line in row.lines:
                print(f"        {line}", flush=True)
            values |= {row.name: row.value, **row.details}
    if json is not None:
        write_json(json, values)


def all_sections(
    robot: Robot, plot: Path | None, python: str
) -> Mapping[str, Callable[[], Iterable[Measurement]]]:
    """Return what measures each section, by name."""
    own = {name: partial(_engine_section, load, robot) for name, load in engine_sections().items()}
    return own | {
        "memory": partial(memory, robot),
        "growth": partial(growth, robot, plot),
        "arms": partial(arms, robot, python),
        "trainer": partial(trainer, robot, python),
        "gpu": partial(_gpu, robot),
    }


def has_gpu() -> bool:
    """Say whether PyTorch finds a GPU."""
    import torch

    return torch.cuda.is_available()


def _gpu(robot: Robot) -> Iterator[Measurement]:
    """Measure on the GPU."""
    import torch

    from training.bench.gpu import gpu

    yield from gpu(robot, torch.device("cuda"))


def _engine_section(load: Callable[[], Section], robot: Robot) -> Iterator[Measurement]:
    """Measure with a demonstrator's commands in the first installed engine."""
    commands = demonstrator_commands(robot, backend_names()[0], _EPISODES, _SEED)
    yield from load()(robot, commands.values)
