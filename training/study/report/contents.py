"""The one list of the report's tables and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from training.study.declare import grid
from training.study.declare.budgets import BUDGETS
from training.study.report.aggregate import aggregate
from training.study.report.cells import Table
from training.study.report.engine_differences import differences
from training.study.report.learning_curves import curve_figures
from training.study.report.nearness import near_and_far, nearness, nearness_figures
from training.study.report.page import Expected, beside_paper
from training.study.report.plant_plots import follow_figures, plant_figures
from training.study.report.reachable import beside_demonstrator
from training.study.report.records import Run
from training.study.report.tables import all_tables
from training.study.report.variant_plots import variant_figures


def paper_tables(runs: Sequence[Run]) -> list[Table]:
    """Return the tables that stand beside the paper's."""
    return list(beside_paper(runs, expected_runs(runs)))


def other_tables(runs: Sequence[Run]) -> list[Table]:
    """Return all other tables."""
    return [
        aggregate(runs),
        *all_tables(runs),
        nearness(near_and_far(runs)),
        differences(runs),
        beside_demonstrator(runs),
    ]


def draw_figures(runs: Sequence[Run], folder: Path) -> list[tuple[str, str]]:
    """Draw all figures into a folder; return the name of each file and its caption."""
    return [
        *curve_figures(runs, folder),
        *variant_figures(runs, folder),
        *follow_figures(runs, folder),
        *nearness_figures(near_and_far(runs), folder),
        *plant_figures(runs, folder),
    ]


def expected_runs(runs: Sequence[Run]) -> Expected | None:
    """Return the runs that each experiment has in the budget of most runs; None if unknown."""
    (budget, _), *_ = Counter(run.budget for run in runs).most_common()
    return grid.expected(BUDGETS[budget]) if budget in BUDGETS else None
