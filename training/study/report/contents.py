"""The list of the report's tables and figures: what is added here appears everywhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from training.study.declare import grid
from training.study.declare.budgets import BUDGETS
from training.study.report.beside_paper import (
    Expected,
    beside_table_2,
    beside_table_3,
    beside_table_4,
)
from training.study.report.cells import Table
from training.study.report.engine_differences import methods, tasks
from training.study.report.learning_curves import Figures, curve_figures
from training.study.report.nearness import far_captures, nearness, nearness_figures
from training.study.report.plant_plots import follow_figures, plant_figures
from training.study.report.records import Run, is_extra, shared
from training.study.report.shipped_policies import shipped
from training.study.report.tables import (
    ablation,
    comparison,
    demonstrations,
    generalization,
    robustness,
)
from training.study.report.tables_beyond import (
    aggregate,
    halvings,
    own_ablation,
    presets,
    raised,
    searches,
)
from training.study.report.transfer_between_engines import transfer, transfer_figures

PAPER_TABLES: tuple[Callable[[Sequence[Run], Expected | None], Table], ...] = (
    beside_table_2,
    beside_table_3,
    beside_table_4,
)
"""Tables that set the paper's numbers beside ours."""
TABLES: tuple[Callable[[Sequence[Run]], Table], ...] = (
    aggregate,
    comparison,
    ablation,
    own_ablation,
    presets,
    raised,
    demonstrations,
    generalization,
    robustness,
    methods,
    halvings,
    tasks,
    nearness,
)
"""The other tables of the study's runs."""
STORED_TABLES: tuple[Callable[[Path], Table], ...] = (searches, shipped)
"""Tables of what other commands stored in the folder of the results."""
FIGURES: tuple[Callable[[Sequence[Run], Path], Figures], ...] = (
    curve_figures,
    follow_figures,
    nearness_figures,
    plant_figures,
)
"""Each draws figures into a folder, and yields the name and the caption of each."""


def paper_tables(runs: Sequence[Run]) -> list[Table]:
    """Return the tables that stand beside the paper's."""
    wanted = expected_runs(runs)
    return [make(_alike(runs), wanted) for make in PAPER_TABLES]


def other_tables(runs: Sequence[Run], results: Path) -> list[Table]:
    """Return all other tables, of runs and of the folder that they come from."""
    common = _alike(runs)
    ours = [make(common) for make in TABLES]
    return [*ours, transfer(runs), far_captures(runs), *(make(results) for make in STORED_TABLES)]


def draw_figures(runs: Sequence[Run], folder: Path) -> list[tuple[str, str]]:
    """Draw all figures into a folder; return the name of each file and its caption."""
    others = [shown for draw in FIGURES for shown in draw(_alike(runs), folder)]
    return [*others, *transfer_figures(runs, folder)]


def _alike(runs: Sequence[Run]) -> list[Run]:
    """Return the runs whose seeds share demonstrations, as those of most tables do, without the
    seeds beyond their budget."""
    return [run for run in shared(runs) if not is_extra(run)]


def expected_runs(runs: Sequence[Run]) -> Expected | None:
    """Return the runs that each experiment has in the budget of most runs; None if unknown."""
    (budget, _), *_ = Counter(run.budget for run in runs).most_common()
    return grid.expected(BUDGETS[budget]) if budget in BUDGETS else None
