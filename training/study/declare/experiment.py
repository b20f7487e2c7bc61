"""An experiment of the study: its runs, without their seeds, and what is measured on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cdcsr.tasks.starts import StartName
from training.config.run_description import Changes, PresetName, RunDescription


@dataclass(frozen=True)
class Cell:
    """One run, for every seed, and the evaluations that an experiment needs of it."""

    spec: RunDescription
    """The run; its seed and its number of updates are set when the runs are collected."""
    evaluations: tuple[str, ...]
    length: int
    """Length of training, as a multiple of the budget's."""
    own_demonstrations: bool = False
    """Each seed records demonstrations of its own, instead of sharing those of seed 0."""
    more_seeds: int = 0
    """How many seeds it has beyond the budget's, instead of those."""


@dataclass(frozen=True)
class Experiment:
    """A part of the study."""

    summary: str
    cells: Sequence[Cell]
    """The cells, in the order in which they are run."""


def trained(
    algorithm: str,
    space: str,
    *evaluations: str,
    length: int = 1,
    backend: str = "mujoco",
    own_demonstrations: bool = False,
    task: str = "reach",
    preset: PresetName = "tuned",
    changes: Changes = (),
    demonstrations: int = 10,
    randomize: float = 0.0,
    soften: float = 0.0,
    start: StartName = "still",
    more_seeds: int = 0,
) -> Cell:
    """Return the cell of a training run; if no evaluation is named it gets the nominal one."""
    spec = RunDescription(
        algorithm=algorithm,
        preset=preset,
        backend=backend,
        space=space,
        task=task,
        num_demonstrations=demonstrations,
        randomize=randomize,
        soften=soften,
        start=start,
        changes=changes,
    )
    return Cell(spec, evaluations or ("nominal",), length, own_demonstrations, more_seeds)


def untrained(name: str, *evaluations: str, task: str = "reach", space: str = "anchor") -> Cell:
    """Return the cell of a controller that does not learn."""
    spec = RunDescription(algorithm=name, space=space, task=task)
    return Cell(spec, evaluations or ("nominal",), 0)
