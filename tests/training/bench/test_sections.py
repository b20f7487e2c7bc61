"""`cdcsr bench` prints rows and keeps their values."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr.cli import main
from cdcsr.simulation.benchmarks import Measurement
from training.bench import sections


def test_an_unknown_section_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "grwth"]) == 2
    error = capsys.readouterr().err
    assert "Unknown section 'grwth'. Did you mean 'growth'?" in error
    assert all(name in error for name in ("memory", "arms", "trainer", "mujoco", "pybullet"))


def test_rows_are_printed_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        Measurement("a", 1.234, "what a is", "the floor", ("a line",), {"more": [1]}),
        Measurement("b", None, "what b is"),
    ]
    monkeypatch.setattr(sections, "all_sections", lambda *_: {"some": lambda: rows})
    sections.run_sections((), tmp_path / "out.json", None, None)
    assert json.loads((tmp_path / "out.json").read_text()) == {"a": 1.234, "more": [1], "b": None}
    assert capsys.readouterr().out.splitlines() == [
        "some:",
        "  1.23  what a is [the floor]",
        "        a line",
        "     -  what b is",
    ]
