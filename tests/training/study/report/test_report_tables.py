"""Which runs a table of the report takes in, and what it says of them, by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from tests.support.small_study import HEAD, beside_paper, find, nominal, write_csv, write_run
from training.measure.statistics import Sweep, halving
from training.report import report
from training.study.declare.budgets import BUDGETS
from training.study.declare.grid import expected
from training.study.report.aggregate import aggregate
from training.study.report.cells import Table, measure
from training.study.report.engine_differences import differences
from training.study.report.page import page
from training.study.report.plant_sweeps import sweeps
from training.study.report.reachable import beside_demonstrator
from training.study.report.records import episodes_of, load_study
from training.study.report.table_parts import engines_of
from training.study.report.tables import (
    ablation,
    comparison,
    demonstrations,
    generalization,
    robustness,
)
from training.study.report.tables import transfer as between_engines
from training.study.report.tables_beyond import halvings, tasks
from training.study.store import read_episodes


def shown(table: Table, *names: str) -> list[tuple[Any, ...]]:
    """Some columns of the rows that something was run for."""
    places = [table.head.index(name) for name in names]
    return [tuple(row[i] for i in places) for row in table.rows if row[table.head.index("seeds")]]


def lengths(
    folder: Path, episodes: list[int], space: str = "anchor", backend: str = "mujoco"
) -> None:
    """Undisturbed episodes in place of the run's, each a success; 250 steps are a failure."""
    rows = [
        [backend, space, "nominal", 0, i, int(n < 250), n, 0.01] for i, n in enumerate(episodes)
    ]
    write_csv(folder / "nominal.csv", HEAD, rows)


# -- which runs


def test_demonstrations_are_the_only_difference_in_their_table(tmp_path: Path) -> None:
    runs: list[tuple[str, str, dict[str, Any]]] = [
        ("few", "1000", {"demonstrations": 3}),
        ("usual", "1110", {}),
        ("many", "1111", {"demonstrations": 20}),
        ("random", "0000", {"demonstrations": 3, "randomize": 1.0}),
        ("switched", "0000", {"demonstrations": 3, "switches": {"critics": 5}}),
        ("task", "0000", {"demonstrations": 3, "task": "quiet"}),
        ("other", "0000", {"demonstrations": 3, "algorithm": "td3"}),
    ]
    for name, outcomes, spec in runs:
        write_run(tmp_path, name, {"nominal": [nominal(outcomes)]}, **spec)
    write_run(
        tmp_path,
        "space",
        {"nominal": [nominal("00", "spatter")]},
        demonstrations=3,
        space="spatter",
    )
    table = demonstrations(load_study(tmp_path))
    found = [
        (count, algorithm, κ.value)
        for count, algorithm, κ in shown(table, "demonstrations", "algorithm", "κ")
    ]
    assert found == [(3, "BATD3", 0.25), (10, "BATD3", 0.75), (20, "BATD3", 1.0)]
    lacking = {(row[0], row[1]) for row in table.rows} - {
        (count, algorithm) for count, algorithm, _ in found
    }
    assert lacking == {
        (5, "BATD3"),
        *((n, a) for n in (3, 5, 10, 20) for a in ("BC", "CLASP (ours)", "TD3wD")),
    }


def test_only_plain_runs_are_ablations_and_stand_between_engines(tmp_path: Path) -> None:
    both = {"nominal": [nominal("10"), nominal("11", backend="pybullet")]}
    specs: dict[str, dict[str, Any]] = {
        "plain": {},
        "switched": {"switches": {"critics": 5}},
        "few": {"demonstrations": 5},
        "random": {"randomize": 1.0},
    }
    for name, spec in specs.items():
        write_run(tmp_path, name, both, algorithm="batd3-no-bc", **spec)
    runs = load_study(tmp_path)
    assert len(shown(ablation(runs), "algorithm")) == 1
    assert len(shown(comparison(runs), "algorithm")) == 1
    (plain,), (random,) = shown(between_engines(runs), "algorithm")
    assert random == f"{plain}, randomized plants"


def test_the_demonstrator_is_one_run_in_each_space_and_is_not_trained_in_any(study: Path) -> None:
    runs = load_study(study)
    for space in ("Anchor", "Floating"):
        row = find(comparison(runs), space=space, algorithm="demonstrator")
        assert (row["seeds"], row["κ"].over) == (1, "episodes")
    assert "demonstrator" not in generalization(runs).markdown()


def test_other_numbers_of_demonstrations_are_not_the_papers(tmp_path: Path) -> None:
    for count in (5, 20):
        write_run(tmp_path, f"d{count}", {"nominal": [nominal("11")]}, demonstrations=count)
    assert shown(comparison(load_study(tmp_path)), "algorithm") == []


# -- where a run was trained, and is tested


def test_each_run_is_measured_in_the_engine_it_was_trained_in(tmp_path: Path) -> None:
    both = {"nominal": [nominal("0000"), nominal("1110", backend="pybullet")]}
    write_run(tmp_path, "one", both, backend="pybullet")
    runs = load_study(tmp_path)
    cell = measure(runs, "nominal", space="anchor")
    assert cell is not None
    assert cell.success.value == 0.75
    assert (cell.length.mean, cell.length.std) == pytest.approx((137.5, (0.75 * 0.25) ** 0.5 * 150))
    two, _, _ = beside_paper(runs, None)
    assert shown(two, "ours κ") == []  # the paper's engine is MuJoCo


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


def test_table_4_has_every_space_and_counts_all_seeds(tmp_path: Path) -> None:
    for seed, (space, nominally, noisy) in enumerate(
        (("anchor", "1111", "1100"), ("anchor", "1111", "1000"), ("spatter", "1110", "0001"))
    ):
        noise = [("mujoco", space, "action_noise", 0.5, noisy)]
        write_run(
            tmp_path,
            f"{seed}",
            {"nominal": [nominal(nominally, space)], "disturbances": noise},
            space=space,
            seed=seed,
        )
    runs = load_study(tmp_path)
    row = find(robustness(runs), what="σ_a", level=0.5, algorithm="BATD3")
    assert (row["κ Anchor"].value, row["κ Spatter"].value, row["κ Floating"]) == (0.375, 0.25, None)
    assert (row["l_epi Anchor"].mean, row["l_epi Spatter"].mean) == (193.75, 212.5)
    assert row["seeds"] == 3
    anybody = find(robustness(runs), what="σ_a", level=0.5, algorithm="any run")
    assert (anybody["κ Anchor"].value, anybody["κ Spatter"].value, anybody["seeds"]) == (
        0.5,
        0.25,
        3,
    )
    *_, four = beside_paper(runs, None)
    found: dict[Any, Any] = {
        row[2]: row[four.head.index("ours κ")] for row in four.rows if row[:2] == ["σ_a", 0.5]
    }
    assert [found["Anchor"].value, found["Spatter"].value, found["Floating"]] == [0.375, 0.25, None]


def test_our_engines_come_before_others(tmp_path: Path) -> None:
    write_run(
        tmp_path,
        "one",
        {"nominal": [nominal("1", backend=name) for name in ("another", "pybullet", "mujoco")]},
    )
    assert engines_of(load_study(tmp_path)) == ["mujoco", "pybullet", "another"]


# -- all spaces together


def test_methods_with_two_seeds_in_all_spaces_are_listed_best_first(tmp_path: Path) -> None:
    for algorithm, outcomes, seeds in (("bc", "1000", 2), ("td3", "1110", 2), ("batd3", "1111", 1)):
        for space in ("anchor", "floating", "spatter"):
            for seed in range(
                seeds + (space == "anchor")
            ):  # the last one is not in the other spaces
                folder = write_run(
                    tmp_path,
                    f"{algorithm}-{space}-{seed}",
                    {"nominal": [nominal(outcomes, space)]},
                    algorithm=algorithm,
                    space=space,
                    seed=seed,
                )
                if seed == seeds:
                    data = json.loads((folder / "run.json").read_text("utf-8"))
                    (folder / "run.json").write_text(
                        json.dumps(data | {"updates": 7, "minutes": 99}), "utf-8"
                    )
    found = shown(
        aggregate(load_study(tmp_path)), "algorithm", "IQM of κ", "seeds", "updates", "minutes"
    )
    assert [(name, κ.value, *rest) for name, κ, *rest in found] == [
        ("TD3", 0.75, 2, "1000", 2.0),
        ("BC", 0.25, 2, "1000", 2.0),
    ]


# -- beside the demonstrator


def test_lengths_are_over_the_demonstrators_in_the_same_engine_and_averaged_over_seeds(
    tmp_path: Path,
) -> None:
    shown_how = write_run(tmp_path, "jacobian", {"nominal": []}, algorithm="jacobian")
    lengths_of = {"mujoco": (100, 100, 100), "pybullet": (200, 250, 100)}
    rows = [
        [engine, "anchor", "nominal", 0, i, int(n < 250), n, 0.01]
        for engine, each in lengths_of.items()
        for i, n in enumerate(each)
    ]
    write_csv(shown_how / "nominal.csv", HEAD, rows)
    # Both reach the first target, in 150 of 200 steps; and the first and the last, in 270 of 300.
    lengths(
        write_run(tmp_path, "s0", {"nominal": []}, backend="pybullet"),
        [150, 50, 250],
        backend="pybullet",
    )
    lengths(
        write_run(tmp_path, "s1", {"nominal": []}, backend="pybullet", seed=1),
        [160, 250, 110],
        backend="pybullet",
    )
    row = find(beside_demonstrator(load_study(tmp_path)), algorithm="BATD3")
    assert row["length over the demonstrator's"] == pytest.approx((0.75 + 0.9) / 2, abs=5e-4)


def test_the_shortest_episodes_are_successful_ones_on_the_demonstrators_targets(
    tmp_path: Path,
) -> None:
    lengths(write_run(tmp_path, "jacobian", {"nominal": []}, algorithm="jacobian"), [100, 120, 250])
    lengths(write_run(tmp_path, "one", {"nominal": []}), [250, 60, 70])
    folder = write_run(tmp_path, "two", {"nominal": []}, algorithm="td3")
    rows = [
        ["mujoco", "anchor", "nominal", 0, i, s, n, 0.01]
        for i, (s, n) in enumerate(((0, 10), (1, 240), (1, 90)))
    ]
    write_csv(folder / "nominal.csv", HEAD, rows)
    row = find(beside_demonstrator(load_study(tmp_path)), algorithm="best of all runs")
    # 100 is its own, as the 10 steps are of a failure; 60; the demonstrator misses the last target.
    assert row["length over the demonstrator's"] == pytest.approx(160 / 220, abs=5e-4)


# -- plants and engines


def test_the_level_trained_on_is_of_the_same_space(tmp_path: Path) -> None:
    run = {
        "nominal": [nominal("1110"), nominal("0000", "floating")],
        "plants": [("mujoco", "anchor", "link_mass", 2, "1100")],
    }
    write_run(tmp_path, "one", run)
    (sweep,) = sweeps(load_study(tmp_path), "link_mass", "mujoco", "anchor").values()
    assert sweep.levels.tolist() == [1, 2]
    assert sweep.outcomes.sum(axis=0).tolist() == [3, 2]
    write_run(tmp_path, "two", {**run, "nominal": [nominal("11101")]})
    with pytest.raises(CdcsrError, match="Run two: levels of link_mass have different episodes"):
        sweeps(load_study(tmp_path), "link_mass", "mujoco", "anchor")


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


def test_episodes_all_around_the_arm_are_compared_too_and_each_run_counts_once(
    tmp_path: Path,
) -> None:
    around = [nominal("110", "workspace"), nominal("011", "workspace", "pybullet")]
    both = [nominal("11"), nominal("10", backend="pybullet")]
    write_run(tmp_path, "one", {"nominal": both, "workspace": around})
    found = {row[0]: row[1:] for row in differences(load_study(tmp_path)).rows}
    assert found["as described"] == [1, 5, 3, 2, 1, "`one`, anchor, 1; `one`, workspace, 0, 2"]


# -- the rest


def test_episodes_are_told_in_their_order_whatever_that_of_the_rows(tmp_path: Path) -> None:
    rows = [["mujoco", "anchor", "nominal", 0, i, int(i == 2), 10 * i, 0.0] for i in (2, 0, 1)]
    write_csv(tmp_path / "nominal.csv", HEAD, rows)
    found = episodes_of(read_episodes(tmp_path / "nominal.csv")).where(space="anchor")
    assert found.episode.tolist() == [0, 1, 2]
    assert found.success.tolist() == [False, False, True]
    assert found.length.tolist() == [0, 10, 20]


def test_what_is_missing_is_told_of_the_budget_that_most_runs_have(tmp_path: Path) -> None:
    for seed, budget in enumerate(("quick", "standard", "standard", None)):
        write_run(
            tmp_path / "study", f"s{seed}", {"nominal": [nominal("11")]}, seed=seed, budget=budget
        )
    report(results=tmp_path / "study", out=tmp_path / "out", json=tmp_path / "report.json")
    lacking = json.loads((tmp_path / "report.json").read_text("utf-8"))["not_run"]["table2"]
    assert set(lacking) == set(expected(BUDGETS["standard"])["table2"])


def test_runs_of_two_robots_are_said_to_be(study: Path) -> None:
    path = study / "jacobian" / "run.json"
    assert "different robots" not in page(load_study(study), [], [], [], None)
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {"fingerprint": "g"}), "utf-8")
    assert "**The runs are of 2 different robots**: f, g." in page(
        load_study(study), [], [], [], None
    )
