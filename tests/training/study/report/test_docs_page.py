"""Docs pages whose numbers come from tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from training.measure.statistics import Estimate
from training.report import report
from training.study.report.cells import Spread, Table
from training.study.report.contents import other_tables, paper_tables
from training.study.report.docs_page import render
from training.study.report.records import load_study

ROOT = Path(__file__).parents[4]
TABLES = {
    "t": Table(
        "t",
        "",
        "",
        ("algorithm", "space", "seeds", "κ", "length"),
        [
            ("BC", "Anchor", 3, Estimate(0.744, 0.7, 0.8), Spread(120.4, 3.0)),
            ("BC", "Spatter", 3, Estimate(0.25, 0.2, 0.3), None),
            ("BC, a = 1", "Anchor", 1, Estimate(0.5, 0.4, 0.6, "episodes"), Spread(9.0, 1.0)),
        ],
    )
}


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("{{t | κ | algorithm=BC; space=Anchor}}", "0.74"),
        ("{{t | κ~ | algorithm=BC; space=Anchor}}", "0.74 (0.70 to 0.80)"),
        ("{{t | κ~ | algorithm=BC\\, a = 1}}", "0.50\\*"),
        ("{{t | length | algorithm=BC; space=Anchor}}", "120"),
        ("{{t | length | algorithm=BC; space=Spatter}}", "-"),
        ("{{t | seeds | space=Spatter}}", "3"),
        ("{{usual algorithm=BC; space=Anchor}}{{t | seeds}}", "3"),
        ("{{usual space=Anchor}}{{t | κ | algorithm=BC; space=Spatter}}", "0.25"),
    ],
)
def test_a_reference_is_the_value_of_its_row(reference: str, text: str) -> None:
    assert render(f"a {reference} b", TABLES).replace("a  ", "a ") == f"a {text} b"


def test_a_grid_has_a_dash_where_there_is_no_row() -> None:
    page = render(
        "{{grid t | κ | algorithm: BC, CLASP | space: Anchor, Spatter | seeds=3}}", TABLES
    )
    assert [line.split("|")[1:-1] for line in page.replace(" ", "").splitlines()[2:]] == [
        ["BC", "0.74", "0.25"],
        ["CLASP", "-", "-"],
    ]


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("{{t | κ | algorithm=BC}}", "meets 2 rows of t, not one"),
        ("{{t | κ | algorithm=RBL}}", "meets 0 rows of t"),
        ("{{u | κ | algorithm=BC}}", "names no table; there are t"),
        ("{{t | success | space=Spatter}}", "names no column of t: algorithm, space"),
    ],
)
def test_a_reference_to_nothing_is_named(reference: str, message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        render(reference, TABLES)


def test_pages_have_the_numbers_of_the_results() -> None:
    runs = load_study(ROOT / "results")
    found = (*paper_tables(runs), *other_tables(runs, ROOT / "results"))
    tables, templates = {one.name: one for one in found}, sorted((ROOT / "docs").glob("*.md.in"))
    for template in templates:
        page = render(template.read_text("utf-8"), tables)
        assert page == template.with_suffix("").read_text("utf-8"), (
            f"run `python -m training.report --docs docs/{template.name}`"
        )
    assert len(templates) >= 3


def test_the_page_of_a_template_is_written_beside_it(study: Path, tmp_path: Path) -> None:
    template = tmp_path / "page.md.in"
    template.write_text("{{usual space=Anchor}}No number.")
    report(results=study, docs=template)
    assert (tmp_path / "page.md").read_text() == "No number."


def test_a_page_that_is_no_template_is_refused(study: Path, tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("")
    with pytest.raises(CdcsrError, match=r"page\.md is no template"):
        report(results=study, docs=tmp_path / "page.md")
