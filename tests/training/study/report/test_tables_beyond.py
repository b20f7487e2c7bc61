"""Tables that go beyond the paper: variants, presets, tasks, plants and transfer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.small_study import find, nominal, shown, small_study, write_run
from training.measure.statistics import Sweep, halving
from training.study.report.contents import other_tables
from training.study.report.engine_differences import tasks
from training.study.report.records import load_study
from training.study.report.tables import comparison
from training.study.report.tables_beyond import halvings, own_ablation, presets, raised
from training.study.report.transfer_between_engines import transfer, transfer_figures


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
    assert own_ablation(runs).rows == []  # its rows are of the preset `tuned`


def test_other_tasks_are_in_their_space_in_order(tmp_path: Path) -> None:
    for task, space in (("reach", "workspace"), ("quiet", "spatter"), ("quiet", "anchor")):
        rows = [nominal("1000", space), nominal("1110", "other")]
        write_run(
            tmp_path,
            f"a-{task}-{space}",
            {"nominal": rows},
            task=task,
            space=space,
            algorithm="td3",
        )
        write_run(tmp_path, f"b-{task}-{space}", {"nominal": rows}, task=task, space=space)
    table = tasks(load_study(tmp_path))
    found = shown(table, "task", "space", "κ in MuJoCo")
    places = [("quiet", "anchor"), ("quiet", "spatter"), ("reach", "workspace")]
    assert [row[:2] for row in found] == [place for place in places for _ in range(2)]
    assert {row[2].value for row in found} == {0.25}


def test_halves_below_and_above_and_what_was_swept(tmp_path: Path) -> None:
    levels = [
        ("rest_length_offset", 0, "1111"),
        ("rest_length_offset", 0.1, "1111"),
        ("rest_length_offset", 0.2, "0000"),
        ("servo_gain", 0.25, "0000"),
        ("servo_gain", 1, "1111"),
        ("servo_gain", 2, "1110"),
    ]
    write_run(tmp_path, "s0", {"plants": [("mujoco", "anchor", *row) for row in levels]})
    more = [("mujoco", "anchor", "servo_gain", level, "1111") for level in (0.5, 1, 3)]
    write_run(tmp_path, "s1", {"plants": more}, seed=1)
    table = halvings(load_study(tmp_path))
    row = find(table, plant="rest length offset [m]")
    assert (row["swept"], row["halves below"], row["halves above"]) == (
        "0 to 0.2",
        "-",
        "0.15 [0.15, 0.15]",
    )
    row = find(table, plant="servo gain [factor]")
    assert row["swept"] == "0.25 to 3"
    assert row["halves above"].startswith("none")
    (tmp_path / "s1" / "plants.csv").unlink()
    # Midway between the factors 1 and 1/4.
    assert (
        find(halvings(load_study(tmp_path)), plant="servo gain [factor]")["halves below"]
        == "0.5 [0.5, 0.5]"
    )


def test_down_to_exactly_half_is_half() -> None:
    """A sweep ends with such a level."""
    outcomes = [[True, True], [True, False]]
    found = halving([Sweep(np.array([1.0, 2.0]), np.array(outcomes))], 1.0, "above")
    assert found is not None
    assert found.level == 2


def test_transfer_is_paired_by_target_over_seeds_with_demonstrations_of_their_own(
    tmp_path: Path,
) -> None:
    small_study(tmp_path)
    for seed, (home, other) in enumerate((("1111", "0111"), ("1101", "1011")), 1):
        rows = [nominal(home), nominal(other, backend="pybullet")]
        write_run(tmp_path, f"own{seed}", {"engines": rows}, seed=seed, demonstration_seed=seed)
    runs = load_study(tmp_path)
    row = find(transfer(runs), algorithm="BATD3")
    assert row["seeds"] == 2  # two seeds of one recipe, and no run of the others
    assert row["κ in MuJoCo"].value == pytest.approx(7 / 8)
    assert row["difference in MuJoCo"] == "-"
    loss = row["difference in PyBullet"]
    assert loss.value == pytest.approx(-1 / 8)
    assert loss.low < -1 / 8 < loss.high
    others = {table.name: table for table in other_tables(runs, tmp_path)}
    assert find(others["engines"], space="Anchor", algorithm="BATD3")["seeds"] == 3
    assert [name for name, _ in transfer_figures(runs, tmp_path)] == ["transfer.png"]
