"""The tables of the paper, made from the study's runs, and the list of all tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import ALGORITHMS, algorithm_title
from training.measure.statistics import rate
from training.study.declare.grid import ABLATIONS, AROUND, COUNTS
from training.study.declare.learner_changes import OURS
from training.study.report.cells import COST, TRAINED, Cell, Table, Value, cost, measure, trained
from training.study.report.paper_numbers import DISTURBANCES, TABLE_4
from training.study.report.records import (
    DEMONSTRATIONS,
    JACOBIAN,
    SPACES,
    Episodes,
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
    engine_heads,
    engines_of,
    home_rows,
    in_engines,
    not_run,
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
    rows = [row for space in SPACES for row in home_rows(chosen, space, COMPARED)]
    return Table(
        "table2", "Table II: comparison", basis(chosen), ("space", *TRAINED, *RESULT, *COST), rows
    )


def ablation(runs: Sequence[Run]) -> Table:
    """Return Fig. 4 in numbers: BATD3 without each of its parts."""
    chosen = [run for run in runs if is_plain(run.setting) and run.setting.algorithm in ABLATIONS]
    rows = [row for space in SPACES for row in home_rows(chosen, space, ABLATIONS)]
    note = (
        f"{basis(chosen)} Without ensemble, the preset `paper-reading` keeps TD3's two critics, "
        "and `tuned` a single one."
    )
    return Table("ablation", "Ablations of BATD3", note, ("space", *TRAINED, *RESULT, *COST), rows)


def demonstrations(runs: Sequence[Run]) -> Table:
    """Return Fig. 5 in numbers: success by the number of demonstrations, in Anchor Space."""
    chosen = counted(runs)
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        rows.append(
            [
                setting.num_demonstrations,
                *trained(setting),
                *result(group, space="anchor"),
                *cost(group),
            ]
        )
    have = {(run.setting.algorithm, run.setting.num_demonstrations) for run in chosen}
    for algorithm in COUNTED:
        rows += [
            [count, *not_run(algorithm)] for count in ALL_COUNTS if (algorithm, count) not in have
        ]
    head = ("demonstrations", *TRAINED, *RESULT, *COST)
    return Table(
        "demonstrations",
        "Fig. 5 in numbers: demonstrations, Anchor Space",
        basis(chosen),
        head,
        rows,
    )


def counted(runs: Iterable[Run]) -> list[Run]:
    """Return the runs in Anchor Space that differ only in algorithm and demonstrations."""
    found = []
    for run in runs:
        s = run.setting
        if (
            is_of_paper(s)
            and s.space == "anchor"
            and s.algorithm in COUNTED
            and not s.changes
            and not s.randomize
        ):
            found.append(run)
    return found


def generalization(runs: Sequence[Run]) -> Table:
    """Return Table III: trained in one space, tested in another, in its engine."""
    chosen = [
        run
        for run in runs
        if is_usual(run.setting) and run.setting.changes in ((), *CHANGES_OF_ALL)
    ]
    chosen = [run for run in chosen if run.setting.algorithm != JACOBIAN]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        rows.append(
            [
                *trained(setting),
                SPACES[setting.space],
                *(success(group, "nominal", space=space) for space in SPACES),
                success(group, AROUND, space=AROUND),
                *cost(group),
            ]
        )
    have = {run.setting.space for run in chosen if run.setting.algorithm == "batd3"}
    for space in SPACES:
        if space not in have:
            rows.append(
                [
                    algorithm_title("batd3"),
                    "-",
                    engine_title("mujoco"),
                    SPACES[space],
                    *[None] * 4,
                    *cost(None),
                ]
            )
    head = (*TRAINED, "on", *(f"κ in {title}" for title in SPACES.values()), "κ all around", *COST)
    return Table("table3", "Table III: generalization between spaces", basis(chosen), head, rows)


def robustness(runs: Sequence[Run]) -> Table:
    """Return Table IV: success under disturbances, in the space and engine of training.

    Level 0 is the nominal evaluation.
    """
    chosen = [run for run in runs if is_usual(run.setting) and "disturbances" in run.evaluations]
    groups = grouped(chosen, "space")
    policies = [
        run for run in chosen if run.setting.algorithm != JACOBIAN
    ]  # to it no packet is lost
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
                rows.append(
                    [
                        letter,
                        level,
                        algorithm_title("batd3"),
                        "-",
                        engine_title("mujoco"),
                        *[None] * 6,
                        *cost(None),
                    ]
                )
    columns = [name for title in SPACES.values() for name in (f"κ {title}", f"l_epi {title}")]
    note = basis(chosen) + (
        " Seeds are counted over the three spaces together. The rows `any run` count the targets"
        " that at least one of the policies above them reaches under that disturbance; their"
        " intervals are over targets."
    )
    return Table(
        "table4", "Table IV: robustness", note, ("what", "level", *TRAINED, *columns, *COST), rows
    )


def _any_run(runs: Sequence[Run], axis: str, level: float) -> list[Value]:
    """Return the rest of a row: the share of targets that at least one run reaches."""
    values: list[Value] = []
    count = 0
    for space in SPACES:
        cell = disturbed(at_home(runs, space), axis, level, space)
        values += [rate([_united(cell.episodes)]) if cell else None, "-"]
        count += len(cell.runs) if cell else 0
    return [ANY_RUN, "-", "-", *values, count, *["-"] * (len(COST) - 1)]


def _united(found: Sequence[Episodes]) -> NDArray[np.bool_]:
    """Return, for each target that occurs, whether any of the episodes succeeds there."""
    targets = np.concatenate([one.episode for one in found])
    success = np.concatenate([one.success for one in found])
    return np.isin(np.unique(targets), targets[success])


def disturbed(runs: Sequence[Run], axis: str, level: float, space: str) -> Cell | None:
    """Measure a cell of Table IV; without rows of its own, level 0 is the nominal evaluation."""
    cell = measure(runs, "disturbances", space=space, axis=axis, level=level)
    return measure(runs, "nominal", space=space) if cell is None and level == 0 else cell


def transfer(runs: Sequence[Run]) -> Table:
    """Return every method trained in each engine and tested in each, on the same targets."""
    chosen = [
        run
        for run in runs
        if is_of_paper(run.setting) and run.setting.num_demonstrations in (0, DEMONSTRATIONS)
    ]
    chosen = [run for run in chosen if not run.setting.changes]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for space in SPACES:
        for setting, group in grouped(chosen, "space").items():
            seeds = at_home(group, space)
            if seeds:
                rows.append(
                    [
                        SPACES[space],
                        *trained(setting),
                        *in_engines(seeds, engines, space),
                        *cost(seeds),
                    ]
                )
    head = ("space", *TRAINED, *engine_heads(engines), *COST)
    note = (
        basis(chosen)
        + " Disagreements count the episodes of all seeds that succeed in one engine only."
    )
    return Table("transfer", "Transfer between engines", note, head, rows)
