"""The report, of small studies whose numbers are known by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from tests.support.small_study import HEAD, beside_paper, find, nominal, write_csv, write_run
from training.measure.statistics import Estimate
from training.report import report
from training.study.report.aggregate import aggregate
from training.study.report.cells import Table
from training.study.report.learning_curves import aligned, curve_figures
from training.study.report.page import missing
from training.study.report.paper_numbers import TABLE_2, TABLE_3, TABLE_4
from training.study.report.reachable import beside_demonstrator
from training.study.report.records import load_study
from training.study.report.tables import comparison, generalization, robustness
from training.study.report.tables_beyond import own_ablation, presets, raised, tasks, variants
from training.study.report.variant_plots import variant_figures


def test_the_papers_numbers_are_the_printed_ones() -> None:
    assert (len(TABLE_2), len(TABLE_3), len(TABLE_4)) == (21, 6, 45)
    assert TABLE_2["td3wd", "floating"][0] == 0.31
    assert (TABLE_2["rlpd", "spatter"][1].mean, TABLE_2["rlpd", "spatter"][1].std) == (227.6, 54.1)
    assert TABLE_3["spatter", "floating"][0] == 0.67
    assert TABLE_4["base_noise", 0.03, "floating"][0] == 0.67
    for (axis, level, space), printed in TABLE_4.items():  # undisturbed, Table IV repeats Table II
        if level == 0:
            assert printed == TABLE_2["batd3", space], axis


def test_comparison(study: Path) -> None:
    table = comparison(load_study(study))
    row = find(table, space="Anchor", algorithm="BATD3")
    # Seeds reach 4, 3 and 1 of 4: (1 + 0.75 + 0.25) / 3. Eight of twelve episodes take 100 steps,
    # four 250.
    assert row["κ"].value == pytest.approx(2 / 3)
    assert (row["κ"].low, row["κ"].high) == pytest.approx((0.25, 1.0))
    assert (row["l_epi"].mean, row["l_epi"].std) == pytest.approx((150.0, 150 * (2 / 9) ** 0.5))
    assert (row["seeds"], row["updates"], row["steps"], row["minutes"]) == (3, "1000", "64000", 2.0)
    spatter = find(table, space="Spatter", algorithm="BATD3")
    assert spatter["κ"].over == "episodes"
    assert find(table, space="Anchor", algorithm="RLPD")["κ"] is None
    assert "not run" in table.markdown()
    assert find(table, space="Floating", algorithm="demonstrator")["κ"].value == 1.0


def test_seeds_of_other_settings_are_not_mixed_in(study: Path) -> None:
    for name, spec in {
        "longer": {"updates": 2000},
        "fewer": {"demonstrations": 5},
        "random": {"randomize": 1.0},
        "switched": {"switches": {"critics": 5}},
        "other": {"task": "quiet"},
    }.items():
        write_run(study, name, {"nominal": [nominal("0000")]}, **spec)
    table = comparison(load_study(study))
    seeds = [row[table.head.index("seeds")] for row in table.rows if row[:2] == ["Anchor", "BATD3"]]
    assert sorted(map(str, seeds)) == [
        "1",
        "3",
    ]  # the longer one stands by itself, the rest elsewhere
    assert [row[:3] for row in tasks(load_study(study)).rows] == [["quiet", "anchor", "BATD3"]]


def test_only_what_somebody_reaches_counts_beside_the_demonstrator(tmp_path: Path) -> None:
    study = tmp_path / "study"
    # No run reaches the last target; one of another setting reaches the third, in the other
    # engine.
    write_run(study, "own", {"nominal": [nominal("1100"), nominal("1100", backend="pybullet")]})
    write_run(
        study,
        "other",
        {"nominal": [nominal("1010", backend="pybullet")]},
        algorithm="bc",
        randomize=1.0,
    )
    write_run(
        study, "fewer", {"nominal": [nominal("1111")]}, demonstrations=3
    )  # its targets may lie elsewhere
    shown = write_run(study, "jacobian", {"nominal": [nominal("0100")]}, algorithm="jacobian")
    write_csv(
        shown / "nominal.csv",
        HEAD,
        [["mujoco", "anchor", "nominal", 0, i, int(i == 1), 125, 0.01] for i in range(4)],
    )
    row = find(beside_demonstrator(load_study(study)), algorithm="BATD3")
    assert row["reachable"] == "3 of 4"
    assert row["κ of reachable"].value == pytest.approx(2 / 3)
    assert (
        row["length over the demonstrator's"] == 0.8
    )  # on the one that both reach, 100 of 125 steps
    best = write_run(study, "best", {"nominal": []}, algorithm="td3")
    write_csv(
        best / "nominal.csv",
        HEAD,
        [["mujoco", "anchor", "nominal", 0, i, i % 2, 75, 0.01] for i in range(4)],
    )
    row = find(beside_demonstrator(load_study(study)), algorithm="best of all runs")
    assert row["length over the demonstrator's"] == 0.6


def test_generalization(study: Path) -> None:
    row = find(generalization(load_study(study)), on="Anchor")
    assert row["κ in Floating"].value == 0.5
    assert row["κ in Spatter"] is None
    assert row["κ all around"] is None
    around = {
        "nominal": [nominal("11")],
        "workspace": [nominal("10", "workspace"), nominal("00", "workspace", "other")],
    }
    both = {"symmetry": True, "practice": 0.3}
    for name, switches in (
        ("plain", {}),
        ("symmetric", {"symmetry": True}),
        ("both", both),
        ("other", {"critics": 5}),
    ):
        write_run(study, name, around, algorithm="clasp", switches=switches)
    table = generalization(load_study(study))
    assert find(table, algorithm="CLASP (ours)")["κ all around"].value == 0.5
    assert find(table, algorithm="CLASP (ours), symmetry = true")["κ all around"].value == 0.5
    assert (
        find(table, algorithm="CLASP (ours), practice = 0.3, symmetry = true")["κ all around"].value
        == 0.5
    )
    assert "critics" not in table.markdown()


def test_robustness_takes_level_zero_from_the_nominal_evaluation(study: Path) -> None:
    table = robustness(load_study(study))
    batd3 = {"algorithm": "BATD3"}
    assert find(table, what="σ_a", level=0.0, **batd3)["κ Anchor"].value == pytest.approx(2 / 3)
    assert find(table, what="σ_a", level=0.5, **batd3)["κ Anchor"].value == 0.25
    assert find(table, what="p", level=1.0, **batd3)["κ Anchor"] is None


def test_robustness_says_what_nobody_reaches(study: Path) -> None:
    # Under noise this run reaches the last target only, the others the first only: two of four.
    noise = [("mujoco", "anchor", "action_noise", 0.5, "0001")]
    write_run(
        study,
        "other",
        {"nominal": [nominal("0001")], "disturbances": noise},
        algorithm="clasp",
        seed=3,
    )
    table = robustness(load_study(study))
    assert find(table, what="σ_a", level=0.0, algorithm="any run")["κ Anchor"].value == 1
    assert find(table, what="σ_a", level=0.5, algorithm="any run")["κ Anchor"].value == 0.5
    assert find(table, what="p", level=1.0, algorithm="any run")["κ Anchor"] is None


def test_curves_are_compared_where_all_seeds_have_been(study: Path) -> None:
    updates, curves = aligned([run for run in load_study(study) if run.setting.space == "anchor"])
    assert updates.tolist() == [500, 1000]
    assert curves.tolist() == [[0.0, 0.5], [0.1, 0.5], [0.2, 0.5]]


def test_curves_of_another_length_have_a_figure_of_their_own(study: Path, tmp_path: Path) -> None:
    before = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert "fig3-tuned-mujoco.png" in before
    curve = [(1000, 0.5), (4000, 0.9)]
    for algorithm in ("td3", "clasp"):
        write_run(
            study,
            algorithm,
            {"nominal": [nominal("1111")]},
            curve,
            algorithm=algorithm,
            updates=4000,
        )
    after = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert after == [*before[:1], "fig3-tuned-mujoco-u4000.png", *before[1:]]


def test_each_variant_has_a_panel_beside_what_it_is_a_variant_of(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, float]] = []

    def draw(*arguments: Any) -> None:
        _, _, group, label, *_ = arguments
        drawn.append((label, aligned(group)[1][:, -1].mean()))

    monkeypatch.setattr("training.study.report.variant_plots.draw_curve", draw)
    for i, switches in enumerate(({"critics": 3}, {"discount": 0.9})):
        write_run(
            study,
            f"v{i}",
            {"nominal": [nominal("11")]},
            [(500, 0.25), (1000, 0.75 + i / 8)],
            switches=switches,
        )
    (figure,) = variant_figures(load_study(study), tmp_path)
    assert figure[0] == "variants-tuned-anchor-mujoco.png"
    assert drawn == [
        ("BATD3", 0.5),
        ("with the change", 0.75),
        ("BATD3", 0.5),
        ("with the change", 0.875),
    ]


def test_the_three_spaces_together_are_one_row_of_the_seeds_that_all_have(tmp_path: Path) -> None:
    outcomes = {
        "anchor": ("1111", "1110", "0000"),
        "floating": ("1100", "1110", "0000"),
        "spatter": ("1000", "0000"),
    }
    for space, rows in outcomes.items():
        for seed, one in enumerate(rows):
            write_run(
                tmp_path,
                f"{space}{seed}",
                {"nominal": [nominal(one, space)]},
                space=space,
                seed=seed,
            )
    (row,) = aggregate(load_study(tmp_path)).rows
    _, _, _, mean, middle, seeds, *_ = row
    assert isinstance(mean, Estimate)
    assert isinstance(middle, Estimate)
    assert mean.value == pytest.approx(3.25 / 6)
    assert middle.value == pytest.approx(np.mean([0.75, 0.75, 0.5, 0.25]))
    assert (seeds, middle.over) == (2, "seeds")
    # Redrawn in each space by itself, a sample may have the best seed of each; the better one has
    # 1.75 / 3 in all.
    assert mean.high > 1.75 / 3 + 0.01


def test_what_is_put_back_to_the_papers_stands_beside_the_preset_and_is_no_variant(
    study: Path,
) -> None:
    for name, switches in (
        ("back", {"features": "state"}),
        ("rate", {"learning_rate": 1e-4}),
        ("other", {"critics": 3}),
    ):
        write_run(study, name, {"nominal": [nominal("1000")]}, switches=switches)
    write_run(
        study, "spatter", {"nominal": [nominal("1", "spatter")]}, algorithm="clasp", space="spatter"
    )
    runs = load_study(study)
    table = presets(runs)
    found: list[dict[str, Any]] = [dict(zip(table.head, row, strict=True)) for row in table.rows]
    names = [(row["space"], row["algorithm"], row["κ"].value) for row in found]
    plain = find(comparison(runs), algorithm="BATD3", space="Anchor", preset="tuned")
    assert names == [
        ("Anchor", "BATD3", plain["κ"].value),
        ("Anchor", "BATD3, features = state", 0.25),
        ("Anchor", "BATD3, learning_rate = 0.0001", 0.25),
    ]
    variants_of = [row[1] for row in own_ablation(runs).rows]
    assert "BATD3, critics = 3" in variants_of
    assert not {name for _, name, _ in names[1:]} & set(variants_of)


def test_what_is_raised_to_tuned_stands_in_its_order_above_the_papers_preset(study: Path) -> None:
    few, more = (
        {"return_steps": 20},
        {"features": "state+error", "num_envs": 64, "return_steps": 20},
    )
    for name, switches in (("more", more), ("few", few), ("none", {}), ("other", {"critics": 3})):
        write_run(study, name, {"nominal": [nominal("1000")]}, preset="paper", switches=switches)
    runs = load_study(study)
    assert [row[1] for row in raised(runs).rows] == [
        "BATD3",
        "BATD3, return_steps = 20",
        "BATD3, features = state+error, num_envs = 64, return_steps = 20",
    ]
    assert not any(run.setting.preset == "paper" for run in variants(runs))


def test_beside_the_paper(study: Path) -> None:
    two, three, four = beside_paper(
        load_study(study), {"fig4": {"batd3-tuned_spatter_mujoco_d10_u1000_s0": ("nominal",)}}
    )
    row = find(two, algorithm="BATD3", space="Anchor")
    assert (row["paper κ"], row["seeds"]) == ("0.76", 3)
    assert row["command"] == (
        "`python -m training.experiments table2 --budget quick --only "
        "'batd3-tuned_anchor_mujoco_d10_u1000_s*'`"
    )
    assert " fig4 " in find(two, algorithm="BATD3", space="Spatter")["command"]
    other, *_ = beside_paper(
        load_study(study), {"fig5": {"batd3-tuned_spatter_mujoco_d10_u77_s0": ("nominal",)}}
    )
    assert " fig5 " in find(other, algorithm="BATD3", space="Spatter")["command"]
    assert find(two, algorithm="TD3", space="Spatter")["ours κ"] is None
    assert find(three, trained_in="Anchor", tested_in="Floating")["ours κ"].value == 0.5
    assert (len(three.rows), len(four.rows)) == (6, 45)


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
        lambda budget: expected if budget.name == "quick" else {},
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
        ("nominal.csv", "backend,space\n", "no column axis, level"),
        (
            "nominal.csv",
            ",".join(HEAD) + "\nmujoco,anchor,nominal,zero,0,1,100,0\n",
            "does not fit",
        ),
        (
            "nominal.csv",
            ",".join(HEAD) + "\nmujoco,anchor,nominal,0,0,7,100,0\n",
            "success that is not 0 or 1",
        ),
        (
            "nominal.csv",
            ",".join(HEAD) + "\nmujoco,anchor,nominal,0,0,1,nan,0\n",
            "length that is none",
        ),
        (
            "nominal.csv",
            ",".join(HEAD) + "\nmujoco,anchor,nominal,0,1,1,100,0\n",
            "episodes 0 to 0 of mujoco, anchor",
        ),
        ("nominal.csv", "\udcff", "no CSV file"),
        ("run.json", "{}", "no field 'spec'"),
        ("run.json", "[", "cannot be read"),
    ],
)
def test_broken_results_are_named(study: Path, file: str, text: str, match: str) -> None:
    (study / "jacobian" / file).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(CdcsrError, match=rf"jacobian.{file}.*{match}"):
        load_study(study)


def test_nothing_to_report(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="--results"):
        report(results=tmp_path / "none", out=tmp_path / "out")
    with pytest.raises(CdcsrError, match="no finished run"):
        report(results=tmp_path, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
