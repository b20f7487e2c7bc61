"""`cdcsr search`: it goes on where it stopped, and refuses what is not its own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr import cli


def test_the_command_goes_on_and_refuses_another_search(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def search(out: Path, episodes: int, *more: str) -> int:
        asked = [
            "search",
            "batd3-spatter-mujoco",
            "--out",
            str(out),
            "--space",
            "anchor",
            "--rounds",
            "1",
        ]
        return cli.main(
            [*asked, "--episodes", str(episodes), "--json", str(tmp_path / "summary.json"), *more]
        )

    whole, halted = tmp_path / "whole", tmp_path / "halted"
    assert search(whole, 2) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["reached"] == 1
    assert summary["best_length"] <= summary["length"]
    assert search(halted, 2) == 0
    lines = (halted / "targets.csv").read_text().splitlines(keepends=True)
    kept = lines[1].replace(
        lines[1].split(",")[5], "12.5"
    )  # what is there already is not made again
    (halted / "targets.csv").write_text(lines[0] + kept)  # stopped after the first target
    assert search(halted, 2) == 0
    assert (halted / "targets.csv").read_text() == lines[0] + kept + lines[2]
    (halted / "targets.csv").write_text("".join(lines[:2]))
    assert search(halted, 2) == 0
    assert (halted / "targets.csv").read_text() == (whole / "targets.csv").read_text()
    assert json.loads((tmp_path / "summary.json").read_text()) == summary

    capsys.readouterr()
    assert search(whole, 2, "--missed") == 2
    assert "holds a search with other options (missed)" in capsys.readouterr().err
    assert search(whole, 1) == 2
    assert "holds a search with other options (episodes)" in capsys.readouterr().err
    (whole / "targets.csv").write_text(lines[0] + lines[2])
    assert search(whole, 2) == 2
    assert "is of other targets: line 2 is of target 1 at (" in capsys.readouterr().err
    (whole / "targets.csv").write_text("episode,x\n0,north\n")
    assert search(whole, 2) == 2
    assert "damaged" in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "targets.csv").write_text("precious")
    for force in ((), ("--force",)):
        assert search(tmp_path / "other", 2, *force) == 2
    assert (tmp_path / "other" / "targets.csv").read_text() == "precious"
    assert "exists and is not a search" in capsys.readouterr().err
    assert search(whole / "search.json" / "below", 2) == 2
    assert "Cannot write" in capsys.readouterr().err
    assert search(tmp_path / "none", 0) == 2
    assert "episodes must be at least 1" in capsys.readouterr().err
