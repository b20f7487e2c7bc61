"""The tables of the paper, made from the study's runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from training.algorithms.registry import ALGORITHMS
from training.measure.statistics import rate
from training.study.declare.grid import ABLATIONS, AROUND, COUNTS
from training.study.declare.learner_changes import OURS
from training.study.report.cells import COST, TRAINED, Cell, Table, Value, cost, measure, trained
from training.study.report.paper_numbers import DISTURBANCES, TABLE_4
from training.study.report.records import (
    DEMONSTRATIONS,
    JACOBIAN,
    SPACES,
    Run,
    at_home,
    grouped,
    is_of_paper,
    is_plain,
    is_usual,
)
from training.study.report.table_parts import (
    RESULT,
    basis,
    home_table,
    not_run,
    not_trained,
    result,
    success,
)
from training.study.report.tables_beyond import CHANGES_OF_ALL

COMPARED = (*(name for name, entry in ALGORITHMS.items() if not entry.ablation), JACOBIAN)
"""Rows of Table II, run or not."""
COUNTED = ("batd3", OURS, "td3wd", "bc")
"""Algorithms whose number of demonstrations varies."""
ANY_RUN = "any run"
"""Name of the row of targets that at least one run reaches."""
ALL_COUNTS = tuple(sorted((*COUNTS, DEMONSTRATIONS)))


def comparison(runs: Sequence[Run]) -> Table:
    """Return Table II: every algorithm in the space and engine it was trained in."""
    chosen = [run for run in runs if is_plain(run.setting)]
    return home_table("table2", "Table II: comparison", chosen, COMPARED)


def ablation(runs: Sequence[Run]) -> Table:
    """Return Fig. 4 in numbers: BATD3 without each of its parts."""
    chosen = [run for run in runs if is_plain(run.setting) and run.setting.algorithm in ABLATIONS]
    remark = (
        " Without ensemble, the preset `paper-reading` keeps TD3's two critics, and `tuned` a "
        "single one."
    )
    return home_table("ablation", "Ablations of BATD3", chosen, ABLATIONS, remark)


def demonstrations(runs: Sequence[Run]) -> Table:
    """Return Fig. 5 in numbers: success by the number of demonstrations, in Anchor Space."""
    chosen = counted(runs)
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        values = [*trained(setting), *result(group, space="anchor"), *cost(group)]
        rows.append([setting.num_demonstrations, *values])
    have = {(run.setting.algorithm, run.setting.num_demonstrations) for run in chosen}
    for algorithm in COUNTED:
        rows += [
            [count, *not_run(algorithm)] for count in ALL_COUNTS if (algorithm, count) not in have
        ]
    head = ("demonstrations", *TRAINED, *RESULT, *COST)
    title = "Fig. 5 in numbers: demonstrations, Anchor Space"
    return Table("demonstrations", title, basis(chosen), head, rows)


def counted(runs: Iterable[Run]) -> list[Run]:
    """Return the runs in Anchor Space that differ only in algorithm and demonstrations."""
    plain = [run for run in runs if is_of_paper(run.setting) and not run.setting.changes]
    return [
        run
        for run in plain
        if run.setting.space == "anchor" and run.setting.algorithm in COUNTED
        if not run.setting.randomized
    ]


def generalization(runs: Sequence[Run]) -> Table:
    """Return Table III: trained in one space, tested in another, in its engine."""
    usual = [run for run in runs if is_usual(run.setting) and run.setting.algorithm != JACOBIAN]
    chosen = [run for run in usual if run.setting.changes in ((), *CHANGES_OF_ALL)]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        values = [success(group, "nominal", space=space) for space in SPACES]
        values.append(success(group, AROUND, space=AROUND))
        rows.append([*trained(setting), SPACES[setting.space], *values, *cost(group)])
    have = {run.setting.space for run in chosen if run.setting.algorithm == "batd3"}
    lacking = [title for space, title in SPACES.items() if space not in have]
    rows += [[*not_trained("batd3"), title, *[None] * 4, *cost(None)] for title in lacking]
    head = (*TRAINED, "on", *(f"κ in {title}" for title in SPACES.values()), "κ all around", *COST)
    return Table("table3", "Table III: generalization between spaces", basis(chosen), head, rows)


def robustness(runs: Sequence[Run]) -> Table:
    """Return Table IV: success under disturbances, in the space and engine of training.

    Level 0 is the nominal evaluation.
    """
    chosen = [run for run in runs if is_usual(run.setting) and "disturbances" in run.evaluations]
    groups = grouped(chosen, "space")
    # The demonstrator asks the simulation, so it loses no packet.
    policies = [run for run in chosen if run.setting.algorithm != JACOBIAN]
    rows: list[list[Value]] = []
    for axis, letter in DISTURBANCES.items():
        for level in sorted({known for name, known, _ in TABLE_4 if name == axis}):
            for setting, group in groups.items():
                values: list[Value] = []
                for space in SPACES:
                    cell = disturbed(at_home(group, space), axis, level, space)
                    values += [cell.success, cell.length] if cell else [None, None]
                rows.append([letter, level, *trained(setting), *values, *cost(group)])
            rows.append([letter, level, *_any_run(policies, axis, level)])
            if not any(setting.algorithm == "batd3" for setting in groups):
                rows.append([letter, level, *not_trained("batd3"), *[None] * 6, *cost(None)])
    columns = [name for title in SPACES.values() for name in (f"κ {title}", f"l_epi {title}")]
    note = basis(chosen) + (
        " Seeds are counted over the three spaces together. The rows `any run` count the targets"
        " that at least one of the policies above them reaches under that disturbance; their"
        " intervals are over targets."
    )
    head = ("what", "level", *TRAINED, *columns, *COST)
    return Table("table4", "Table IV: robustness", note, head, rows)


def _any_run(runs: Sequence[Run], axis: str, level: float) -> list[Value]:
    """Return the rest of a row: the share of targets that at least one run reaches."""
    values: list[Value] = []
    count = 0
    for space in SPACES:
        cell = disturbed(at_home(runs, space), axis, level, space)
        values += [rate([_united(cell)]) if cell else None, "-"]
        count += len(cell.runs) if cell else 0
    return [ANY_RUN, "-", "-", *values, count, *["-"] * (len(COST) - 1)]


def _united(cell: Cell) -> NDArray[np.bool_]:
    """Return, for each target that occurs, whether any of the episodes succeeds there."""
    targets = np.concatenate([one.episode for one in cell.episodes])
    success = np.concatenate([one.success for one in cell.episodes])
    return np.isin(np.unique(targets), targets[success])


def disturbed(runs: Sequence[Run], axis: str, level: float, space: str) -> Cell | None:
    """Measure a cell of Table IV; without rows of its own, level 0 is the nominal evaluation."""
    cell = measure(runs, "disturbances", space=space, axis=axis, level=level)
    return measure(runs, "nominal", space=space) if cell is None and level == 0 else cell
