"""Success on reachable targets, and lengths relative to the demonstrator's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.small_study import HEAD, find, nominal, write_csv, write_run
from training.study.report.reachable import beside_demonstrator
from training.study.report.records import load_study


def lengths(
    folder: Path, episodes: list[int], space: str = "anchor", backend: str = "mujoco"
) -> None:
    """Replace a run's undisturbed episodes; those of 250 steps are failures."""
    rows = [
        [backend, space, "nominal", 0, i, int(n < 250), n, 0.01] for i, n in enumerate(episodes)
    ]
    write_csv(folder / "nominal.csv", HEAD, rows)


def test_only_targets_that_a_run_reaches_count_beside_the_demonstrator(tmp_path: Path) -> None:
    study = tmp_path / "study"
    # No run reaches the last target; a run of another setting, in the other engine, reaches the
    # third. The targets of the run with fewer demonstrations may lie elsewhere.
    write_run(study, "own", {"nominal": [nominal("1100"), nominal("1100", backend="pybullet")]})
    other = {"nominal": [nominal("1010", backend="pybullet")]}
    write_run(study, "other", other, algorithm="bc", randomize=1.0)
    write_run(study, "fewer", {"nominal": [nominal("1111")]}, demonstrations=3)
    shown = write_run(study, "jacobian", {"nominal": []}, algorithm="jacobian")
    lengths(shown, [250, 125, 250, 250])
    row = find(beside_demonstrator(load_study(study)), algorithm="BATD3")
    assert row["reachable"] == "3 of 4"
    assert row["κ of reachable"].value == pytest.approx(2 / 3)
    # On the target that both reach: 100 of 125 steps.
    assert row["length over the demonstrator's"] == 0.8
    lengths(write_run(study, "best", {"nominal": []}, algorithm="td3"), [250, 75, 250, 75])
    row = find(beside_demonstrator(load_study(study)), algorithm="best of all runs")
    assert row["length over the demonstrator's"] == 0.6


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
    for seed, steps in enumerate(([150, 50, 250], [160, 250, 110])):
        run = write_run(tmp_path, f"s{seed}", {"nominal": []}, backend="pybullet", seed=seed)
        lengths(run, steps, backend="pybullet")
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
