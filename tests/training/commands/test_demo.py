"""The main job: leaves everything it promises, does each stage once, and goes on where it was stopped."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdcsr.cli import main
from cdcsr.errors import CdcsrError
from training.commands import demo_stages as demo
from training.commands.demo_stages import DEMO_FOLDER, Amounts, Stages, run_demo
from training.config.run_config import PRESETS, Train
from training.plots import video

FILES = ["a.txt"]


def tiny(minutes: float) -> Amounts:
    learner = replace(
        PRESETS["tuned"],
        updates=20,
        bc_updates=50,
        bc_rollouts=2,
        num_envs=4,
        batch_size=32,
        hidden=(32, 32),
    )
    return Amounts(minutes, episodes=2, filmed=1, learner=learner)


class Killed(BaseException):
    """Stands for whatever ends the process."""


@pytest.mark.usefixtures("third_engine")
def test_demo_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "FRAME_PERIOD", 0.3)
    monkeypatch.setattr(demo, "Train", partial(Train, evaluate_episodes=2))
    out, calls = tmp_path / "demo", []
    parts = (
        "build_model",
        "demonstrate",
        "train",
        "transfer",
        "draw_learning_curve",
        "draw_targets",
        "policy_video",
    )
    killed_in = "transfer"

    def watched(name: str, part: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            calls.append(name)
            if name == killed_in:
                raise Killed
            return part(*args, **options)

        return call

    for name in parts:
        monkeypatch.setattr(demo, name, watched(name, getattr(demo, name)))
    # Training runs out of its minutes after one update, and the process ends in the stage after it.
    with pytest.raises(Killed):
        run_demo(out, tiny(minutes=1e-6))
    assert calls == list(parts[:4])
    assert not (out / "runs/batd3/summary.json").exists()

    killed_in, calls[:] = "", []
    first = run_demo(out, tiny(minutes=1e-6))
    assert calls == list(parts[3:])
    assert first["training"]["update"] == 1
    check_contents(out, first)

    calls.clear()
    assert run_demo(out, tiny(minutes=1e-6)) == first
    assert calls == []

    # With more minutes training goes on, and all that follows from the policy is made anew.
    more = run_demo(out, tiny(minutes=5))
    assert calls == list(parts[2:])
    assert more["training"]["update"] == 20
    assert (out / "runs/batd3/summary.json").exists()


def check_contents(out: Path, summary: dict[str, Any]) -> None:
    """One folder with everything, and nothing beside."""
    assert sorted(path.name for path in out.iterdir()) == [
        "demo.json",
        "demonstrations",
        "learning_curve.png",
        "model",
        "policy.gif",
        "policy.mp4",
        "runs",
        "targets.png",
        "transfer.json",
        "transfer.md",
    ]
    assert {path.name for path in (out / "model").iterdir()} >= {
        "paper.xml",
        "paper.urdf",
        "cables.json",
    }
    cells = json.loads((out / "transfer.json").read_text())["cells"]
    assert [cell["controller"].partition("-")[0] for cell in cells] == ["jacobian"] * 3 + [
        "bc"
    ] * 3 + ["batd3"] * 3
    assert [cell["backend"] for cell in cells] == ["mujoco", "pybullet", "third"] * 3
    for cell in cells:
        np.testing.assert_array_equal(cell["targets"], cells[0]["targets"])
        assert len(cell["success"]) == 2
    table = (out / "transfer.md").read_text()
    assert all(cell["controller"] in table for cell in cells)
    assert json.loads(json.dumps(summary)) == summary


def test_a_stage_is_done_once_for_the_same_inputs(tmp_path: Path) -> None:
    calls: list[int] = []

    def work() -> None:
        calls.append(1)
        (tmp_path / "demo" / "a.txt").touch()

    with DEMO_FOLDER.claim(tmp_path / "demo"):
        Stages(tmp_path / "demo").run("a", {"x": 1}, FILES, work)
    Stages(tmp_path / "demo").run("a", {"x": 1}, FILES, work)
    assert len(calls) == 1
    Stages(tmp_path / "demo").run("a", {"x": 2}, FILES, work)
    assert len(calls) == 2
    (tmp_path / "demo" / "a.txt").unlink()
    Stages(tmp_path / "demo").run("a", {"x": 2}, FILES, work)
    assert len(calls) == 3


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(CdcsrError, match="not the folder of a demo"):
        run_demo(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(CdcsrError, match="not the folder of a demo"):
        run_demo(tmp_path / "thesis.tex")


@pytest.mark.parametrize("text", ["{", "[1]", "\xff"])
def test_a_damaged_record_is_reported(tmp_path: Path, text: str) -> None:
    (tmp_path / "demo.json").write_text(text, encoding="latin-1")
    with pytest.raises(CdcsrError, match=r"demo\.json cannot be read"):
        run_demo(tmp_path)


@pytest.mark.parametrize("minutes", ["0", "-1", "nan"])
def test_minutes_must_be_positive(
    tmp_path: Path, minutes: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path / "demo"), "--minutes", minutes]) == 2
    assert "minutes must be positive" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()
