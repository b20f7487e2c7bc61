"""The report, of small studies whose numbers are known by hand."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cdcsr.errors import CdcsrError
from training.report import report
from training.study.cells import Table
from training.study.figures import _looks, aligned, curve_figures
from training.study.page import beside_paper, missing
from training.study.paper import TABLE_2, TABLE_3, TABLE_4
from training.study.plants import sweeps
from training.study.reachable import beside_demonstrator
from training.study.records import load_study
from training.study.statistics import Estimate
from training.study.tables import (
    comparison,
    generalization,
    halvings,
    own_ablation,
    presets,
    raised,
    robustness,
    tasks,
    transfer,
    variants,
)  # fmt: skip
from training.style import RUN_COLORS

HEAD = ["backend", "space", "axis", "level", "episode", "success", "length", "distance"]
Row = tuple[str, str, str, float, str]
"""Engine, space, axis, level, and the outcomes of its episodes as in "110"."""


def write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *rows])


def write_run(study: Path, name: str, evaluations: Mapping[str, Sequence[Row]], curve: Sequence[tuple[int, float]] = (),
              **spec: Any) -> Path:  # fmt: skip
    """A finished run; successes take 100 steps."""
    folder = study / name
    folder.mkdir(parents=True)
    usual = {"algorithm": "batd3", "preset": "tuned", "backend": "mujoco", "space": "anchor", "task": "reach",
             "seed": 0, "demonstrations": 10, "updates": 1000, "randomize": 0.0, "switches": {},
             "budget": "quick"}  # fmt: skip
    data = {"spec": {**usual, **spec}, "minutes": 2.0, "updates": 1000, "environment_steps": 64000,
            "versions": {"numpy": "2.0"}, "robot": "paper", "fingerprint": "f"}  # fmt: skip
    (folder / "run.json").write_text(json.dumps(data), "utf-8")
    for evaluation, rows in evaluations.items():
        episodes = [[*row[:4], i, x, 100 if x == "1" else 250, 0.01] for row in rows for i, x in enumerate(row[4])]
        write_csv(folder / f"{evaluation}.csv", HEAD, episodes)
    if curve:
        write_csv(folder / "metrics.csv", ["update", "success_rate"], curve)
    return folder


def nominal(outcomes: str, space: str = "anchor", backend: str = "mujoco") -> Row:
    return backend, space, "nominal", 0, outcomes


def find(table: Table, **wanted: Any) -> dict[str, Any]:
    """The one row with these values, by head."""
    rows = [dict(zip(table.head, row, strict=True)) for row in table.rows]
    (row,) = [row for row in rows if all(row[name.replace("_", " ")] == value for name, value in wanted.items())]
    return row


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Three seeds of BATD3 in Anchor Space, one of it in Spatter, and a demonstrator."""
    folder = tmp_path / "study"
    for seed, (own, other) in enumerate((("1111", "1110"), ("1110", "1110"), ("1000", "0001"))):
        rows = [nominal(own), nominal(other, backend="pybullet"), nominal("1100", "floating")]
        noise = [("mujoco", "anchor", "action_noise", 0.5, "1000")]
        curve = [(500, 0.1 * seed), (1000, 0.5)] + [(1500, 0.9)] * (seed == 0)
        write_run(folder, f"batd3-tuned_anchor_mujoco_d10_u1000_s{seed}", {"nominal": rows, "disturbances": noise},
                  curve, seed=seed)  # fmt: skip
    write_run(
        folder, "batd3-tuned_spatter_mujoco_d10_u1000_s0", {"nominal": [nominal("10", "spatter")]}, space="spatter"
    )
    write_run(folder, "jacobian", {"nominal": [nominal("1111"), nominal("1111", "floating")]}, algorithm="jacobian")
    return folder


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
    # Seeds reach 4, 3 and 1 of 4: (1 + 0.75 + 0.25) / 3. Eight of twelve episodes take 100 steps, four 250.
    assert row["κ"].value == pytest.approx(2 / 3)
    assert (row["κ"].low, row["κ"].high) == pytest.approx((0.25, 1.0))
    assert (row["l_epi"].mean, row["l_epi"].std) == pytest.approx((150.0, 150 * (2 / 9) ** 0.5))
    assert (row["seeds"], row["updates"], row["minutes"]) == (3, "1000", 2.0)
    spatter = find(table, space="Spatter", algorithm="BATD3")
    assert spatter["κ"].over == "episodes"
    assert find(table, space="Anchor", algorithm="RLPD")["κ"] is None
    assert "not run" in table.markdown()
    assert find(table, space="Floating", algorithm="demonstrator")["κ"].value == 1.0


def test_seeds_of_other_settings_are_not_mixed_in(study: Path) -> None:
    for name, spec in {"longer": {"updates": 2000}, "fewer": {"demonstrations": 5}, "random": {"randomize": 1.0},
                       "switched": {"switches": {"critics": 5}}, "other": {"task": "quiet"}}.items():  # fmt: skip
        write_run(study, name, {"nominal": [nominal("0000")]}, **spec)
    rows = [row for row in comparison(load_study(study)).rows if row[:2] == ["Anchor", "BATD3"]]
    assert sorted(str(row[-3]) for row in rows) == ["1", "3"]  # the longer one stands by itself, the rest elsewhere
    assert [row[:3] for row in tasks(load_study(study)).rows] == [["quiet", "anchor", "BATD3"]]


def test_only_what_somebody_reaches_counts_beside_the_demonstrator(tmp_path: Path) -> None:
    study = tmp_path / "study"
    # Nobody reaches the last target; the third only one that is no seed of this setting, in the other engine.
    write_run(study, "own", {"nominal": [nominal("1100"), nominal("1100", backend="pybullet")]})
    write_run(study, "other", {"nominal": [nominal("1010", backend="pybullet")]}, algorithm="bc", randomize=1.0)
    write_run(study, "fewer", {"nominal": [nominal("1111")]}, demonstrations=3)  # its targets may lie elsewhere
    shown = write_run(study, "jacobian", {"nominal": [nominal("0100")]}, algorithm="jacobian")
    write_csv(
        shown / "nominal.csv", HEAD, [["mujoco", "anchor", "nominal", 0, i, int(i == 1), 125, 0.01] for i in range(4)]
    )
    row = find(beside_demonstrator(load_study(study)), algorithm="BATD3")
    assert row["reachable"] == "3 of 4"
    assert row["κ of reachable"].value == pytest.approx(2 / 3)
    assert row["length over the demonstrator's"] == 0.8  # on the one that both reach, 100 of 125 steps
    best = write_run(study, "best", {"nominal": []}, algorithm="td3")
    write_csv(best / "nominal.csv", HEAD, [["mujoco", "anchor", "nominal", 0, i, i % 2, 75, 0.01] for i in range(4)])
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
    for name, switches in (("plain", {}), ("symmetric", {"symmetry": True}), ("both", both), ("other", {"critics": 5})):
        write_run(study, name, around, algorithm="clasp", switches=switches)
    table = generalization(load_study(study))
    assert find(table, algorithm="CLASP (ours)")["κ all around"].value == 0.5
    assert find(table, algorithm="CLASP (ours), symmetry = true")["κ all around"].value == 0.5
    assert find(table, algorithm="CLASP (ours), practice = 0.3, symmetry = true")["κ all around"].value == 0.5
    assert "critics" not in table.markdown()


def test_robustness_takes_level_zero_from_the_nominal_evaluation(study: Path) -> None:
    table = robustness(load_study(study))
    batd3 = {"algorithm": "BATD3"}
    assert find(table, what="σ_a", level=0.0, **batd3)["κ Anchor"].value == pytest.approx(2 / 3)
    assert find(table, what="σ_a", level=0.5, **batd3)["κ Anchor"].value == 0.25
    assert find(table, what="p", level=1.0, **batd3)["κ Anchor"] is None


def test_robustness_says_what_nobody_reaches(study: Path) -> None:
    # Under noise this run reaches the last target only, and all others the first only: together two of four.
    noise = [("mujoco", "anchor", "action_noise", 0.5, "0001")]
    write_run(study, "other", {"nominal": [nominal("0001")], "disturbances": noise}, algorithm="clasp", seed=3)
    table = robustness(load_study(study))
    assert find(table, what="σ_a", level=0.0, algorithm="any run")["κ Anchor"].value == 1
    assert find(table, what="σ_a", level=0.5, algorithm="any run")["κ Anchor"].value == 0.5
    assert find(table, what="p", level=1.0, algorithm="any run")["κ Anchor"] is None


def test_transfer_counts_paired_disagreements(study: Path) -> None:
    row = find(transfer(load_study(study)), space="Anchor", algorithm="BATD3")
    # 1111 and 1110; 1110 and 1110; 1000 and 0001.
    assert row["only MuJoCo / only PyBullet"] == "2 / 1 of 12"
    assert row["κ in PyBullet"].value == pytest.approx((0.75 + 0.75 + 0.25) / 3)


def test_halving_levels(study: Path) -> None:
    levels = [("mujoco", "anchor", "link_mass", level, outcomes) for level, outcomes in ((2, "1111"), (4, "0000"))]
    run = {"nominal": [nominal("1111")], "plants": levels}
    write_run(study, "plants", run, algorithm="bc")
    runs = load_study(study)
    (sweep,) = sweeps(runs, "link_mass", "mujoco", "anchor").values()
    assert sweep.levels.tolist() == [1, 2, 4]  # 1 is from the nominal evaluation
    row = find(halvings(runs), plant="link mass [factor]")
    # Midway between 2 and 4, which are factors, is their geometric mean.
    assert (row["halves above"], row["halves below"], row["swept"]) == ("2.83 [2.83, 2.83]", "-", "1 to 4")


def test_curves_are_compared_where_all_seeds_have_been(study: Path) -> None:
    updates, curves = aligned([run for run in load_study(study) if run.setting.space == "anchor"])
    assert updates.tolist() == [500, 1000]
    assert curves.tolist() == [[0.0, 0.5], [0.1, 0.5], [0.2, 0.5]]


def test_curves_of_another_length_have_a_figure_of_their_own(study: Path, tmp_path: Path) -> None:
    before = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert "fig3-tuned-mujoco.png" in before
    curve = [(1000, 0.5), (4000, 0.9)]
    for algorithm in ("td3", "clasp"):
        write_run(study, algorithm, {"nominal": [nominal("1111")]}, curve, algorithm=algorithm, updates=4000)
    after = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert after == [*before[:1], "fig3-tuned-mujoco-u4000.png", *before[1:]]


def test_no_two_variants_look_alike(study: Path) -> None:
    setting = load_study(study)[0].setting
    settings = [replace(setting, switches=(("critics", str(i)),)) for i in range(2 * len(RUN_COLORS))]
    looks = _looks({"Spatter": {one: [] for one in settings}}, counts=False)
    assert len(set(looks.values())) == len(settings)


def test_what_is_put_back_to_the_papers_stands_beside_the_preset_and_is_no_variant(study: Path) -> None:
    for name, switches in (
        ("back", {"features": "state"}),
        ("rate", {"learning_rate": 1e-4}),
        ("other", {"critics": 3}),
    ):
        write_run(study, name, {"nominal": [nominal("1000")]}, switches=switches)
    write_run(study, "spatter", {"nominal": [nominal("1", "spatter")]}, algorithm="clasp", space="spatter")
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
    assert not {name for _, name, _ in names} & set(variants_of)


def test_what_is_raised_to_tuned_stands_in_its_order_above_the_papers_preset(study: Path) -> None:
    few, more = {"return_steps": 20}, {"features": "state+error", "num_envs": 64, "return_steps": 20}
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
        "`python -m training.experiments table2 --budget quick --only 'batd3-tuned_anchor_mujoco_d10_u1000_s*'`"
    )
    assert " fig4 " in find(two, algorithm="BATD3", space="Spatter")["command"]
    other, *_ = beside_paper(load_study(study), {"fig5": {"batd3-tuned_spatter_mujoco_d10_u77_s0": ("nominal",)}})
    assert " fig5 " in find(other, algorithm="BATD3", space="Spatter")["command"]
    assert find(two, algorithm="TD3", space="Spatter")["ours κ"] is None
    assert find(three, trained_in="Anchor", tested_in="Floating")["ours κ"].value == 0.5
    assert (len(three.rows), len(four.rows)) == (6, 45)


def test_table_as_text_and_numbers() -> None:
    table = Table("t", "T", "", ("a", "κ"), [["x", Estimate(0.5, 0.25, 0.75, "episodes")], ["y", None]])
    assert table.markdown().splitlines()[2:] == ["| x | 0.50 [0.25, 0.75]* |", "| y | not run            |"]
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
    monkeypatch.setattr("training.study.grid.expected", lambda budget: expected if budget.name == "quick" else {})
    out, data = tmp_path / "report", tmp_path / "report.json"
    report(results=study, out=out, json=data)
    text = (out / "README.md").read_text("utf-8")
    assert "| table2 | 1 of 3 | `her_s*` (2) |" in text
    assert f"| plants | 0 of 1 | `{there.replace('s0', 's*')}`: plants, follow |" in text
    for file in out.glob("*.png"):
        assert f"({file.name})" in text
    assert (out / "fig3-tuned-mujoco.png").is_file()
    lacking = {"table2": {"her_s0": ["nominal"], "her_s1": ["nominal"]}, "plants": {there: ["plants", "follow"]}}
    assert missing(load_study(study), expected) == lacking
    assert json.loads(data.read_text("utf-8"))["not_run"] == lacking
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    report(results=study, out=out)
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    with pytest.raises(CdcsrError, match="no report"):
        report(results=study, out=study)


def test_figures_of_following_and_of_plants(study: Path, tmp_path: Path) -> None:
    plants = [("mujoco", "anchor", "servo_gain", level, "1100") for level in (0.5, 1, 2)]
    folder = write_run(study, "bc", {"nominal": [nominal("1111")], "plants": plants}, algorithm="bc")
    head = ["backend", "motion", "episode", "step", "tip_error", "base_position_error", "base_attitude_error"]
    write_csv(folder / "follow.csv", head, [["mujoco", "down", 0, step, 0.01, 0.001, 0.02] for step in (25, 50)])
    report(results=study, out=tmp_path / "out")
    assert {"fig6-anchor-mujoco.png", "plants-anchor-mujoco.png"} <= {
        file.name for file in (tmp_path / "out").iterdir()
    }


@pytest.mark.parametrize(
    ("file", "text", "match"),
    [
        ("nominal.csv", "backend,space\n", "no column axis, level"),
        ("nominal.csv", ",".join(HEAD) + "\nmujoco,anchor,nominal,zero,0,1,100,0\n", "does not fit"),
        ("run.json", "{}", "no field 'spec'"),
        ("run.json", "[", "cannot be read"),
    ],
)
def test_broken_results_are_named(study: Path, file: str, text: str, match: str) -> None:
    (study / "jacobian" / file).write_text(text, "utf-8")
    with pytest.raises(CdcsrError, match=rf"jacobian.{file}.*{match}"):
        load_study(study)


def test_nothing_to_report(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="--results"):
        report(results=tmp_path / "none", out=tmp_path / "out")
    with pytest.raises(CdcsrError, match="no finished run"):
        report(results=tmp_path, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_no_engine_and_no_torch_is_needed(study: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from training.report import report; "
        f"report(results=Path({str(study)!r}), out=Path({str(tmp_path / 'out')!r})); "
        "print(sorted({'torch', 'mujoco', 'pybullet'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path.cwd())
    assert done.stdout.splitlines()[-1] == "[]"
