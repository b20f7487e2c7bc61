"""`python -m training.report`: every table and figure of the study, and a page of them, from its CSV files alone."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cdcsr.cli import run
from cdcsr.errors import CdcsrError
from cdcsr.files import new_folder, write_json, write_text

if TYPE_CHECKING:
    from training.study.report.page import Expected
    from training.study.report.records import Run

PAGE = "README.md"


def report(
    *,
    results: Path = Path("results/study"),
    out: Path = Path("results/report"),
    json: Path | None = None,
) -> None:
    """Rebuild every table and figure of the study from its committed results; no engine runs, nothing is trained.

    Args:
        results: folder of the study's results, one folder for each finished run.
        out: folder of the report; one that is there already is replaced.
        json: also write all tables to this file.
    """
    from training.study.report.aggregate import aggregate
    from training.study.report.engine_differences import differences
    from training.study.report.learning_curves import curve_figures
    from training.study.report.nearness import near_and_far, nearness, nearness_figures
    from training.study.report.page import beside_paper, missing, page
    from training.study.report.plant_plots import follow_figures, plant_figures
    from training.study.report.plant_sweeps import check_axes
    from training.study.report.reachable import beside_demonstrator
    from training.study.report.records import load_study
    from training.study.report.tables import all_tables
    from training.study.report.variant_plots import variant_figures

    runs = load_study(results)
    if not runs:
        raise CdcsrError(
            f"{results} holds no finished run; make some with `python -m training.experiments`."
        )
    check_axes(runs)
    wanted = _expected(runs)
    rows = near_and_far(runs)
    paper, tables = (
        list(beside_paper(runs, wanted)),
        [
            aggregate(runs),
            *all_tables(runs),
            nearness(rows),
            differences(runs),
            beside_demonstrator(runs),
        ],
    )
    with new_folder(out, "a report", force=True) as folder:
        figures = [*curve_figures(runs, folder), *variant_figures(runs, folder)]
        figures += [
            *follow_figures(runs, folder),
            *nearness_figures(rows, folder),
            *plant_figures(runs, folder),
        ]
        for table in (*paper, *tables):
            write_text(folder / f"{table.name}.csv", table.csv())
        write_text(folder / PAGE, page(runs, paper, tables, figures, wanted))
    if json is not None:
        write_json(
            json,
            {
                "runs": [one.name for one in runs],
                "tables": {table.name: table.as_dict() for table in (*paper, *tables)},
                "figures": dict(figures),
                "not_run": None if wanted is None else missing(runs, wanted),
            },
        )
    print(
        f"{out / PAGE}: {len(runs)} runs, {len(paper) + len(tables)} tables, {len(figures)} figures"
    )


def _expected(runs: Sequence[Run]) -> Expected | None:
    """The runs each experiment has in the budget that most runs have been made with; None if it is unknown."""
    from training.study.declare.budgets import BUDGETS
    from training.study.declare.grid import expected

    (budget, _), *_ = Counter(one.budget for one in runs).most_common()
    return expected(BUDGETS[budget]) if budget in BUDGETS else None


def main() -> int:
    """Rebuild the report from the command line."""
    return run(report, "training.report", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
