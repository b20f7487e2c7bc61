"""Tables of success in each engine, by the engine of training."""

from __future__ import annotations

from collections.abc import Sequence

from cdcsr.simulation.engines import engine_title
from training.study.report.cells import COST, TRAINED, Table, Value, cost, trained
from training.study.report.records import DEMONSTRATIONS, SPACES, Run, at_home, grouped, is_of_paper
from training.study.report.table_parts import basis, engines_of, success


def methods(runs: Sequence[Run]) -> Table:
    """Return every method trained in each engine and tested in each, on the same targets."""
    chosen = [run for run in runs if is_of_paper(run.setting) and not run.setting.changes]
    chosen = [run for run in chosen if run.setting.num_demonstrations in (0, DEMONSTRATIONS)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for space in SPACES:
        for setting, group in grouped(chosen, "space").items():
            seeds = at_home(group, space)
            if seeds:
                values = _in_engines(seeds, engines, space)
                rows.append([SPACES[space], *trained(setting), *values, *cost(seeds)])
    head = ("space", *TRAINED, *_heads(engines), *COST)
    return Table("engines", "Methods in every engine", basis(chosen), head, rows)


def tasks(runs: Sequence[Run]) -> Table:
    """Return tasks and spaces beyond the paper, in every engine."""
    chosen = [run for run in runs if not is_of_paper(run.setting)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for setting, group in sorted(
        grouped(chosen).items(), key=lambda item: (item[0].task, item[0].space)
    ):
        values = _in_engines(group, engines, setting.space)
        rows.append([setting.task, setting.space, *trained(setting), *values, *cost(group)])
    head = ("task", "space", *TRAINED, *_heads(engines), *COST)
    return Table("tasks", "Tasks beyond the paper", basis(chosen), head, rows)


def _heads(engines: Sequence[str]) -> list[str]:
    return [f"κ in {engine_title(name)}" for name in engines]


def _in_engines(seeds: Sequence[Run], engines: Sequence[str], space: str) -> list[Value]:
    return [success(seeds, "nominal", space, engine) for engine in engines]
