"""`python -m training.report`: every table and figure of the study, from its results alone."""

from __future__ import annotations

import sys
from pathlib import Path

from cdcsr.cli import run
from cdcsr.errors import CdcsrError
from cdcsr.files import write_json, write_text
from cdcsr.folders import new_folder

PAGE = "README.md"


def report(
    *,
    results: Path = Path("results"),
    out: Path = Path("build/report"),
    docs: Path | None = None,
    json: Path | None = None,
) -> None:
    """Build every table and figure of the study from its results; nothing is simulated.

    Args:
        results: the store of results, or a working folder of the study.
        out: the folder of the report; an older report there is replaced.
        docs: instead, fill the numbers of this template, a file that ends in .md.in, and write the
            page beside it.
        json: also write all tables to this file.
    """
    from training.study.report.contents import (
        draw_figures,
        expected_runs,
        other_tables,
        paper_tables,
    )
    from training.study.report.docs_page import render
    from training.study.report.page import missing, page
    from training.study.report.plant_sweeps import check_axes
    from training.study.report.records import load_study

    runs = load_study(results)
    if not runs:
        raise CdcsrError(
            f"{results} holds no finished run; make some with `python -m training.experiments`."
        )
    check_axes(runs)
    paper, tables, wanted = paper_tables(runs), other_tables(runs, results), expected_runs(runs)
    if docs is not None:
        if not docs.name.endswith(".md.in") or not docs.is_file():
            raise CdcsrError(f"{docs} is no template; give a file that ends in .md.in.")
        known = {table.name: table for table in (*paper, *tables)}
        write_text(docs.with_suffix(""), render(docs.read_text("utf-8"), known))
        print(f"written to {docs.with_suffix('')}")
        return
    with new_folder(out, "a report", force=True) as folder:
        figures = draw_figures(runs, folder)
        for table in (*paper, *tables):
            write_text(folder / f"{table.name}.csv", table.csv())
        write_text(folder / PAGE, page(runs, paper, tables, figures, wanted))
    if json is not None:
        data = {
            "runs": [one.name for one in runs],
            "tables": {table.name: table.as_dict() for table in (*paper, *tables)},
            "figures": dict(figures),
            "not_run": None if wanted is None else missing(runs, wanted),
        }
        write_json(json, data)
    count = len(paper) + len(tables)
    print(f"{out / PAGE}: {len(runs)} runs, {count} tables, {len(figures)} figures")


def main() -> int:
    """Build the report from the command line."""
    return run(report, "training.report", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
