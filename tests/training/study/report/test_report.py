"""The report as a whole, its learning curves, and results that are broken or missing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from tests.support.small_study import HEAD, nominal, write_csv, write_run
from training.measure.statistics import Estimate
from training.report import report
from training.study.declare.budgets import BUDGETS
from training.study.declare.grid import expected
from training.study.report.cells import Table
from training.study.report.learning_curves import aligned, curve_figures
from training.study.report.page import missing, page
from training.study.report.records import episodes_of, load_study
from training.study.store import read_episodes

ROW = ",".join(HEAD) + "\nmujoco,anchor,nominal,"
"""The beginning of a table of episodes."""


def test_table_as_text_and_numbers() -> None:
    table = Table(
        "t", "T", "", ("a", "κ"), [["x", Estimate(0.5, 0.25, 0.75, "episodes")], ["y", None]]
    )
    assert table.markdown().splitlines()[2:] == [
        "| x | 0.50 [0.25, 0.75]* |",
        "| y | not run            |",
    ]
    assert table.csv() == "a,κ,κ low,κ high\nx,0.5,0.25,0.75\ny,,,\n"
    # Where a column does not begin with its estimates.
    table = Table("t", "T", "", ("κ", "b"), [["-", 1], [Estimate(0.5, 0.25, 0.75, "seeds"), 2]])
    assert table.csv() == "κ,κ low,κ high,b\n,,,1\n0.5,0.25,0.75,2\n"


def test_report_is_whole_and_replaces_only_reports(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = "batd3-tuned_spatter_mujoco_d10_u1000_s0"
    expected = {
        "table2": {there: ("nominal",), "her_s0": ("nominal",), "her_s1": ("nominal",)},
        "plants": {there: ("nominal", "plants", "follow")},
    }
    monkeypatch.setattr(
        "training.study.declare.grid.expected",
        lambda budget: expected if budget.name == "standard" else {},
    )
    out, data = tmp_path / "report", tmp_path / "report.json"
    report(results=study, out=out, json=data)
    text = re.sub(" +", " ", (out / "README.md").read_text("utf-8"))
    assert "| table2 | 1 of 3 | `her_s*` (2) |" in text
    assert f"| plants | 0 of 1 | `{there.replace('s0', 's*')}`: plants, follow |" in text
    for file in out.glob("*.png"):
        assert f"({file.name})" in text
    assert (out / "fig3-tuned-mujoco.png").is_file()
    lacking = {
        "table2": {"her_s0": ["nominal"], "her_s1": ["nominal"]},
        "plants": {there: ["plants", "follow"]},
    }
    assert missing(load_study(study), expected) == lacking
    assert json.loads(data.read_text("utf-8"))["not_run"] == lacking
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    report(results=study, out=out)
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    with pytest.raises(CdcsrError, match="not a report"):
        report(results=study, out=study)


@pytest.mark.parametrize(
    ("file", "text", "match"),
    [
        ("nominal.csv", "backend,space\n", "has no rows"),
        ("nominal.csv", "backend,space\nmujoco,anchor\n", "no column axis, level"),
        ("nominal.csv", f"{ROW}zero,0,1,100,0\n", "does not fit"),
        ("nominal.csv", f"{ROW}0,0,7,100,0\n", "success that is not 0 or 1"),
        ("nominal.csv", f"{ROW}0,0,1,nan,0\n", "length that is none"),
        ("nominal.csv", f"{ROW}0,1,1,100,0\n", "episodes 0 to 0 of mujoco, anchor"),
        ("nominal.csv", "\udcff", "it is not UTF-8"),
        ("run.json", "{}", "no field 'spec'"),
        ("run.json", "[", "cannot be read"),
    ],
)
def test_broken_results_are_named(study: Path, file: str, text: str, match: str) -> None:
    (study / "jacobian" / file).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(CdcsrError, match=rf"jacobian.{file}.*{match}"):
        load_study(study)


@pytest.mark.parametrize("part", ["task", "space", "backend", "evaluation"])
def test_a_name_in_a_result_leads_to_no_other_folder(
    part: str, study: Path, tmp_path: Path
) -> None:
    bad = "../../../elsewhere"
    engine, spec = (bad, {}) if part == "evaluation" else ("mujoco", {part: bad})
    write_run(study, "td3_s0", {"nominal": [nominal("1111", backend=engine)]}, **spec)
    with pytest.raises(CdcsrError, match="must be a name of letters"):
        report(results=study, out=tmp_path / "a" / "b" / "report")
    assert not list(tmp_path.rglob("*elsewhere*"))


def test_nothing_to_report(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="--results"):
        report(results=tmp_path / "none", out=tmp_path / "out")
    with pytest.raises(CdcsrError, match="no finished run"):
        report(results=tmp_path, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_episodes_are_sorted(tmp_path: Path) -> None:
    rows = [["mujoco", "anchor", "nominal", 0, i, int(i == 2), 10 * i, 0.0] for i in (2, 0, 1)]
    write_csv(tmp_path / "nominal.csv", HEAD, rows)
    found = episodes_of(read_episodes(tmp_path / "nominal.csv")).where(space="anchor")
    assert found.episode.tolist() == [0, 1, 2]
    assert found.success.tolist() == [False, False, True]
    assert found.length.tolist() == [0, 10, 20]


def test_missing_runs_are_those_of_the_most_frequent_budget(tmp_path: Path) -> None:
    for seed, budget in enumerate(("quick", "paper", "paper", None)):
        write_run(
            tmp_path / "study", f"s{seed}", {"nominal": [nominal("11")]}, seed=seed, budget=budget
        )
    report(results=tmp_path / "study", out=tmp_path / "out", json=tmp_path / "report.json")
    lacking = json.loads((tmp_path / "report.json").read_text("utf-8"))["not_run"]["table2"]
    assert set(lacking) == set(expected(BUDGETS["paper"])["table2"])


def test_runs_of_two_robots_are_said_to_be(study: Path) -> None:
    path = study / "jacobian" / "run.json"
    assert "different robots" not in page(load_study(study), [], [], [], None)
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {"fingerprint": "g"}), "utf-8")
    text = page(load_study(study), [], [], [], None)
    assert "**The runs are of 2 different robots**: f, g." in text


def test_curves_are_compared_where_all_seeds_have_been(study: Path) -> None:
    updates, curves = aligned([run for run in load_study(study) if run.setting.space == "anchor"])
    assert updates.tolist() == [500, 1000]
    assert curves.tolist() == [[0.0, 0.5], [0.1, 0.5], [0.2, 0.5]]


def test_curves_of_another_length_have_a_figure_of_their_own(study: Path, tmp_path: Path) -> None:
    before = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert "fig3-tuned-mujoco.png" in before
    curve = [(1000, 0.5), (4000, 0.9)]
    for algorithm in ("td3", "clasp"):
        results = {"nominal": [nominal("1111")]}
        write_run(study, algorithm, results, curve, algorithm=algorithm, updates=4000)
    after = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert after == [*before[:1], "fig3-tuned-mujoco-u4000.png", *before[1:]]
