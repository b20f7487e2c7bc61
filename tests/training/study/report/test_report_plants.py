"""The report on two engines, and on plants that differ from the description."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from tests.support.small_study import find, nominal, write_csv, write_run
from training.report import report
from training.study.report.engine_differences import methods
from training.study.report.plant_sweeps import sweeps
from training.study.report.records import load_study
from training.study.report.tables_beyond import halvings


def test_methods_show_success_in_each_engine(study: Path) -> None:
    row = find(methods(load_study(study)), space="Anchor", algorithm="BATD3")
    # 1111 and 1110; 1110 and 1110; 1000 and 0001.
    assert row["κ in MuJoCo"].value == pytest.approx((1 + 0.75 + 0.25) / 3)
    assert row["κ in PyBullet"].value == pytest.approx((0.75 + 0.75 + 0.25) / 3)


def test_halving_levels(study: Path) -> None:
    levels = [
        ("mujoco", "anchor", "link_mass", level, outcomes)
        for level, outcomes in ((2, "1111"), (4, "0000"))
    ]
    run = {"nominal": [nominal("1111")], "plants": levels}
    write_run(study, "plants", run, algorithm="bc")
    runs = load_study(study)
    (sweep,) = sweeps(runs, "link_mass", "mujoco", "anchor").values()
    assert sweep.levels.tolist() == [1, 2, 4]  # 1 is from the nominal evaluation
    row = find(halvings(runs), plant="link mass [factor]")
    # Midway between 2 and 4, which are factors, is their geometric mean.
    assert (row["halves above"], row["halves below"], row["swept"]) == (
        "2.83 [2.83, 2.83]",
        "-",
        "1 to 4",
    )


def test_figures_of_following_and_of_plants(study: Path, tmp_path: Path) -> None:
    plants = [("mujoco", "anchor", "servo_gain", level, "1100") for level in (0.5, 1, 2)]
    folder = write_run(
        study, "bc", {"nominal": [nominal("1111")], "plants": plants}, algorithm="bc"
    )
    head = [
        "backend",
        "motion",
        "episode",
        "step",
        "tip_error",
        "base_position_error",
        "base_attitude_error",
    ]
    write_csv(
        folder / "follow.csv",
        head,
        [["mujoco", "down", 0, step, 0.01, 0.001, 0.02] for step in (25, 50)],
    )
    report(results=study, out=tmp_path / "out")
    assert {"fig6-anchor-mujoco.png", "plants-anchor-mujoco.png"} <= {
        file.name for file in (tmp_path / "out").iterdir()
    }


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
