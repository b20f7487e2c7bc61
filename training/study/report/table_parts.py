"""Parts that the tables share: rows, heads, and what numbers rest on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from cdcsr.simulation.engines import backend_names, engine_title
from training.algorithms.registry import algorithm_title
from training.study.report.cells import COST, TRAINED, Table, Value, amount, cost, measure, trained
from training.study.report.records import SPACES, Run, at_home, grouped

RESULT = ("κ", "IQM of κ", "l_epi")
"""Heads of what :func:`result` gives."""


def engines_of(runs: Iterable[Run], evaluation: str = "nominal") -> list[str]:
    """Return the engines that some runs were evaluated in, installed ones first."""
    names = {
        str(x)
        for run in runs
        if evaluation in run.evaluations
        for x in run.evaluations[evaluation].backend
    }
    installed = backend_names()
    return sorted(names, key=lambda name: (name not in installed, name))


def basis(runs: Sequence[Run]) -> str:
    """Say what some numbers rest on, in a sentence."""
    if not runs:
        return "No run of this is finished."
    return (
        f"{amount([len(runs)], 'run')}, "
        f"{amount(map(len, grouped(runs).values()), 'seed')} a setting, "
        f"{amount((run.updates for run in runs), 'update')} a run, "
        f"{np.sum([run.minutes for run in runs]):.0f} minutes of training in all."
    )


def home_rows(runs: Sequence[Run], space: str, wanted: Sequence[str] = ()) -> Iterator[list[Value]]:
    """Yield the rows of one space, and one for each wanted algorithm that has no run there."""
    have = set()
    for setting, group in grouped(runs, "space").items():
        seeds = at_home(group, space)
        if seeds:
            have.add(setting.algorithm)
            yield [SPACES[space], *trained(setting), *result(seeds, space=space), *cost(seeds)]
    for algorithm in wanted:
        if algorithm not in have:
            yield [SPACES[space], *not_run(algorithm)]


def home_table(
    name: str, title: str, runs: Sequence[Run], wanted: Sequence[str] = (), remark: str = ""
) -> Table:
    """Build a table of success in the space and engine of training.

    Args:
        name: the name of its files.
        title: its title.
        runs: the runs it shows.
        wanted: algorithms that get a row in every space, run or not.
        remark: what its note says besides what it rests on.
    """
    rows = [row for space in SPACES for row in home_rows(runs, space, wanted)]
    return Table(name, title, basis(runs) + remark, ("space", *TRAINED, *RESULT, *COST), rows)


def result(seeds: Sequence[Run], space: str) -> list[Value]:
    cell = measure(seeds, "nominal", space=space)
    return [cell.success, cell.iqm or "-", cell.length] if cell else [None, None, None]


def success(seeds: Sequence[Run], evaluation: str, space: str, engine: str | None = None) -> Value:
    cell = measure(seeds, evaluation, engine, space=space)
    return cell.success if cell else None


def not_run(algorithm: str) -> list[Value]:
    return [*not_trained(algorithm), None, None, None, *cost(None)]


def not_trained(algorithm: str) -> list[Value]:
    """Return the columns of :func:`trained` for an algorithm without a run."""
    return [algorithm_title(algorithm), "-", engine_title("mujoco")]
