"""The table of the study of transfer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.small_study import find, nominal, small_study, write_run
from training.study.report.contents import other_tables
from training.study.report.records import load_study
from training.study.report.transfer_between_engines import transfer, transfer_figures


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
