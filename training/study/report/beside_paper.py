"""Tables II, III and IV of the paper, with our numbers beside the printed ones."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from training.algorithms.registry import algorithm_title
from training.study.report.cells import COST, Cell, Table, Value, cost, measure
from training.study.report.paper_numbers import DISTURBANCES, TABLE_2, TABLE_3, TABLE_4, Printed
from training.study.report.records import SPACES, Run, at_home, grouped, is_plain
from training.study.report.table_parts import basis
from training.study.report.tables import disturbed

ENGINE = "mujoco"
"""The paper's engine; only runs trained and tested in it stand beside the paper's."""
Expected = Mapping[str, Mapping[str, Sequence[str]]]
"""The runs of each experiment by name, with the evaluations that it needs of each."""
_HEAD = ("paper κ", "ours κ", "paper l_epi", "ours l_epi", "preset", *COST, "command")


def beside_table_2(runs: Sequence[Run], expected: Expected | None) -> Table:
    """Build Table II beside the paper, a row for each cell of the paper's and preset of ours.

    Args:
        runs: the runs of the study.
        expected: the runs of each experiment, to name the experiment that a run is from.
    """
    chosen = _chosen(runs)
    rows: list[list[Value]] = []
    for (algorithm, space), printed in TABLE_2.items():
        own = [run for run in chosen if run.setting.algorithm == algorithm]
        cells = [
            measure(at_home(group, space), "nominal", space=space)
            for group in grouped(own, "space").values()
        ]
        names: list[Value] = [algorithm_title(algorithm), SPACES[space]]
        rows += _rows(names, printed, cells, ("table2", algorithm, space), expected or {})
    return _table(
        "paper2", "Table II beside the paper", basis(chosen), ("algorithm", "space"), rows
    )


def beside_table_3(runs: Sequence[Run], expected: Expected | None) -> Table:
    """Build Table III beside the paper; arguments as for :func:`beside_table_2`."""
    batd3 = [run for run in _chosen(runs) if run.setting.algorithm == "batd3"]
    rows: list[list[Value]] = []
    for (source, space), printed in TABLE_3.items():
        groups = grouped(run for run in batd3 if run.setting.space == source)
        cells = [measure(group, "nominal", space=space) for group in groups.values()]
        names: list[Value] = [SPACES[source], SPACES[space]]
        rows += _rows(names, printed, cells, ("table3", "batd3", source), expected or {})
    title, head = "Table III beside the paper (BATD3)", ("trained in", "tested in")
    return _table("paper3", title, basis(batd3), head, rows)


def beside_table_4(runs: Sequence[Run], expected: Expected | None) -> Table:
    """Build Table IV beside the paper; arguments as for :func:`beside_table_2`."""
    batd3 = [run for run in _chosen(runs) if run.setting.algorithm == "batd3"]
    rows: list[list[Value]] = []
    for (axis, level, space), printed in TABLE_4.items():
        groups = grouped(run for run in batd3 if run.setting.space == space)
        cells = [disturbed(group, axis, level, space) for group in groups.values()]
        names: list[Value] = [DISTURBANCES[axis], level, SPACES[space]]
        rows += _rows(names, printed, cells, ("table4", "batd3", space), expected or {})
    title, head = "Table IV beside the paper (BATD3)", ("what", "level", "space")
    return _table("paper4", title, basis(batd3), head, rows)


def _chosen(runs: Sequence[Run]) -> list[Run]:
    return [run for run in runs if is_plain(run.setting) and run.setting.backend == ENGINE]


def seedless(name: str) -> str:
    """Return a pattern that the names of all seeds of a run fit."""
    return re.sub(r"_s\d+", "_s*", name)


def _table(
    name: str, title: str, note: str, head: Sequence[str], rows: Sequence[Sequence[Value]]
) -> Table:
    return Table(name, title, note, (*head, *_HEAD), rows)


def _rows(
    names: list[Value],
    printed: Printed,
    cells: Sequence[Cell | None],
    source: tuple[str, str, str],
    expected: Expected,
) -> Iterator[list[Value]]:
    """Yield a row for each of our cells, or one that says there is none."""
    printed_kappa, length = printed
    kappa = f"{printed_kappa:.2f}"
    found = [cell for cell in cells if cell]
    for cell in found:
        run = cell.runs[0]
        options = f"--budget {run.budget} " if run.budget else ""
        known = [name for name, names in expected.items() if run.name in names]
        if not known:  # of another budget
            known = [
                name
                for name, names in expected.items()
                if lengthless(run.name) in map(lengthless, names)
            ]
        experiment = source[0] if source[0] in known or not known else known[0]
        command = (
            f"`python -m training.experiments {experiment} {options}--only '{seedless(run.name)}'`"
        )
        yield [
            *names,
            kappa,
            cell.success,
            length,
            cell.length,
            run.setting.preset,
            *cost(cell.runs),
            command,
        ]
    if not found:
        experiment, algorithm, space = source
        only = f"--only '{algorithm}-*_{space}_{ENGINE}_*'"
        command = f"`python -m training.experiments {experiment} {only}`"
        yield [*names, kappa, None, length, None, "-", *cost(None), command]


def lengthless(name: str) -> str:
    """Return a pattern that the names of a run with any number of updates fit."""
    return re.sub(r"_u\d+", "_u*", name)
