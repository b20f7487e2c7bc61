"""The rows `any run` of Table IV, beside the demonstrator's."""

from __future__ import annotations

from pathlib import Path

from tests.support.small_study import find, nominal, write_run
from training.study.report.records import load_study
from training.study.report.tables import robustness


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
