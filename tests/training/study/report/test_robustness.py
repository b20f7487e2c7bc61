"""Table IV: success under disturbances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.small_study import beside_paper, find, nominal, write_run
from training.study.report.paper_numbers import TABLE_2, TABLE_3, TABLE_4
from training.study.report.records import load_study
from training.study.report.tables import (
    robustness,
)


def test_the_papers_numbers_are_the_printed_ones() -> None:
    assert (len(TABLE_2), len(TABLE_3), len(TABLE_4)) == (21, 6, 45)
    assert TABLE_2["td3wd", "floating"][0] == 0.31
    assert (TABLE_2["rlpd", "spatter"][1].mean, TABLE_2["rlpd", "spatter"][1].std) == (227.6, 54.1)
    assert TABLE_3["spatter", "floating"][0] == 0.67
    assert TABLE_4["base_noise", 0.03, "floating"][0] == 0.67
    assert TABLE_4["packet_loss", 0.0, "spatter"] == TABLE_2["batd3", "spatter"]  # undisturbed


def test_robustness_takes_level_zero_from_the_nominal_evaluation(study: Path) -> None:
    table = robustness(load_study(study))
    batd3 = {"algorithm": "BATD3"}
    assert find(table, what="σ_a", level=0.0, **batd3)["κ Anchor"].value == pytest.approx(2 / 3)
    assert find(table, what="σ_a", level=0.5, **batd3)["κ Anchor"].value == 0.25
    assert find(table, what="p", level=1.0, **batd3)["κ Anchor"] is None


def test_robustness_counts_the_targets_that_any_run_reaches(study: Path) -> None:
    # Under noise this run reaches the last target only, the others the first only: two of four.
    noise = [("mujoco", "anchor", "action_noise", 0.5, "0001")]
    results = {"nominal": [nominal("0001")], "disturbances": noise}
    write_run(study, "other", results, algorithm="clasp", seed=3)
    table = robustness(load_study(study))
    assert find(table, what="σ_a", level=0.0, algorithm="any run")["κ Anchor"].value == 1
    assert find(table, what="σ_a", level=0.5, algorithm="any run")["κ Anchor"].value == 0.5
    assert find(table, what="p", level=1.0, algorithm="any run")["κ Anchor"] is None


def test_table_4_has_every_space_and_counts_all_seeds(tmp_path: Path) -> None:
    for seed, (space, nominally, noisy) in enumerate(
        (("anchor", "1111", "1100"), ("anchor", "1111", "1000"), ("spatter", "1110", "0001"))
    ):
        noise = [("mujoco", space, "action_noise", 0.5, noisy)]
        results = {"nominal": [nominal(nominally, space)], "disturbances": noise}
        write_run(tmp_path, f"{seed}", results, space=space, seed=seed)
    runs = load_study(tmp_path)
    row = find(robustness(runs), what="σ_a", level=0.5, algorithm="BATD3")
    assert (row["κ Anchor"].value, row["κ Spatter"].value, row["κ Floating"]) == (0.375, 0.25, None)
    assert (row["l_epi Anchor"].mean, row["l_epi Spatter"].mean) == (193.75, 212.5)
    assert row["seeds"] == 3
    row = find(robustness(runs), what="σ_a", level=0.5, algorithm="any run")
    assert (row["κ Anchor"].value, row["κ Spatter"].value, row["seeds"]) == (0.5, 0.25, 3)
    *_, four = beside_paper(runs, None)
    found: dict[Any, Any] = {
        row[2]: row[four.head.index("ours κ")] for row in four.rows if row[:2] == ["σ_a", 0.5]
    }
    assert [found["Anchor"].value, found["Spatter"].value, found["Floating"]] == [0.375, 0.25, None]


def test_the_demonstrator_counts_as_any_run_in_all_spaces_or_in_none(tmp_path: Path) -> None:
    spaces = ("anchor", "floating", "spatter")
    for space in spaces:
        lost = [("mujoco", space, "packet_loss", 1, "1000")]
        run = {"nominal": [nominal("1100", space)], "disturbances": lost}
        write_run(tmp_path, f"batd3-{space}", run, space=space)
    # It asks the simulation, so it loses no packet; it is disturbed in Anchor alone.
    lost = [("mujoco", "anchor", "packet_loss", 1, "1111")]
    run = {"nominal": [nominal("1111", space) for space in spaces], "disturbances": lost}
    write_run(tmp_path, "jacobian", run, algorithm="jacobian")
    for level in (0.0, 1.0):
        row = find(robustness(load_study(tmp_path)), what="p", level=level, algorithm="any run")
        assert len({row[f"κ {space.title()}"].value for space in spaces}) == 1


def test_beside_the_paper(study: Path) -> None:
    two, three, four = beside_paper(
        load_study(study), {"fig4": {"batd3-tuned_spatter_mujoco_d10_u1000_s0": ("nominal",)}}
    )
    row = find(two, algorithm="BATD3", space="Anchor")
    assert (row["paper κ"], row["seeds"]) == ("0.76", 3)
    assert row["command"] == (
        "`python -m training.experiments table2 --budget standard --only "
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
