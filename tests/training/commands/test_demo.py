"""The demo writes everything it promises, does each stage once, and can be resumed."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from backends.export import summary
from cdcsr.cli import main
from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, sealed, write_json
from cdcsr.simulation.engines import backend_names, load_backend
from tests.support.tiny import tiny_changes
from training.commands import demo_stages
from training.commands.demo_stages import (
    DEMO_FOLDER,
    Amounts,
    Demo,
    Stage,
    carry_out,
    engine_on_gpu,
    run_demo,
)
from training.device.doors import HostDoor
from training.plots import video
from training.policy import Policy
from training.run.device_run import train_on_device
from training.run.train_options import Train


def tiny(minutes: float) -> Amounts:
    changes = tiny_changes("batd3", bc_updates=50, bc_rollouts=2, hidden=(32, 32))
    return Amounts(
        minutes, episodes=2, validation_episodes=2, filmed=1, updates=20, changes=changes
    )


def engines() -> list[str]:
    """The engines that are measured in: enough to be quick, and one of a package that is new."""
    assert {"mujoco", "pybullet", "third"} <= set(backend_names())
    return ["mujoco", "third"]


class Killed(BaseException):
    """Stands for whatever ends the process."""


def done_stages(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The stages whose work was done since the last call."""
    lines = capsys.readouterr().out.splitlines()
    titles = [line.removeprefix("==> ") for line in lines if line.startswith("==> ")]
    return [title for title in titles if not title.endswith(": done before")]


@pytest.mark.usefixtures("third_engine")
def test_a_demo_is_resumed_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(video, "FRAME_PERIOD", 1.0)
    monkeypatch.setattr(summary, "accurate_step", lambda *_: 0.001)  # what it finds is not shown
    monkeypatch.setattr(demo_stages, "working_engines", engines)
    out = tmp_path / "demo"

    def killed(*_: object, **__: object) -> None:
        raise Killed

    # Training runs out of its minutes after one update; the process ends in the stage after it.
    with monkeypatch.context() as patch:
        patch.setattr(demo_stages, "transfer", killed)
        with pytest.raises(Killed):
            run_demo(out, tiny(minutes=1e-6))
    before = ["models of the robot", "ten demonstrations in MuJoCo", "BC and BATD3 in MuJoCo"]
    after = ["the same held-out targets in every engine", "figures", "video"]
    assert done_stages(capsys) == [*before, after[0]]
    assert not (out / "runs/batd3/summary.json").exists()

    first = run_demo(out, tiny(minutes=1e-6))
    assert done_stages(capsys) == after
    check_contents(out, first, update=1)
    assert run_demo(out, tiny(minutes=1e-6)) == first
    assert done_stages(capsys) == []

    # With more minutes training goes on, and all that follows from the policy is done again.
    more = run_demo(out, tiny(minutes=5))
    assert done_stages(capsys) == [before[-1], *after]
    check_contents(out, more, update=20)
    assert (out / "runs/batd3/summary.json").exists()


def check_contents(out: Path, summary: dict[str, object], update: int) -> None:
    """Check that one folder holds everything, and nothing else."""
    assert sorted(path.name for path in out.iterdir() if not path.name.startswith(".")) == [
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
    models = {path.name for path in (out / "model").iterdir()}
    assert models >= {"paper.xml", "paper.urdf", "cables.json"}
    assert json.loads(json.dumps(summary)) == summary
    assert isinstance(summary["training"], dict)
    assert summary["training"]["update"] == update
    cells = json.loads((out / "transfer.json").read_text())["cells"]
    found = [(cell["controller"].partition("-")[0], cell["backend"]) for cell in cells]
    assert found == [(name, engine) for name in ("jacobian", "bc", "batd3") for engine in engines()]
    table = (out / "transfer.md").read_text()
    for cell in cells:
        np.testing.assert_array_equal(cell["targets"], cells[0]["targets"])
        assert len(cell["success"]) == 2
        assert cell["controller"] in table


def test_a_short_demo_measures_less_and_says_what_it_shows() -> None:
    short, usual = Amounts.within(1.0), Amounts.within(20.0)
    assert (short.episodes, short.validation_episodes, short.filmed) == (12, 12, 1)
    assert (usual.episodes, usual.validation_episodes, usual.filmed) == (100, 100, 3)
    assert (short.updates, short.changes) == (usual.updates, usual.changes)  # it can go on
    assert Amounts.within(1e-3).episodes == 10
    said = short.shown({"update": 1234.0, "minutes": 1.02})
    assert "1,234 of 9,000 updates in 1.0 minutes" in said
    assert "not how well it learns" in said
    assert "not how" not in short.shown({"update": 9000.0, "minutes": 6.0})


def test_a_stage_is_done_once_for_the_same_inputs(tmp_path: Path) -> None:
    calls: list[int] = []
    folder = tmp_path / "demo"

    def do(x: int) -> int:
        def work() -> None:
            calls.append(x)
            (folder / "a.txt").touch()

        carry_out(folder, [Stage("a", {"x": x}, ("a.txt",), work)])
        return len(calls)

    with DEMO_FOLDER.claim(folder):
        assert [do(1), do(1), do(2)] == [1, 1, 2]
        (folder / "a.txt").unlink()
        assert do(2) == 3


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
    with pytest.raises(CdcsrError, match=r"(?i)cannot (be )?read"):
        run_demo(tmp_path)


@pytest.mark.usefixtures("third_engine")
def test_a_demo_uses_a_gpu_if_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, asked = tmp_path / "demo", list[Train]()

    def learn(config: Train, device: torch.device) -> list[Policy]:
        assert device.type == "cuda"
        asked.append(config)
        return train_on_device(config, torch.device("cpu"))

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(CdcsrError, match=r"no engine that steps on one \(pip install"):
        run_demo(out, tiny(1), "cuda")
    monkeypatch.setattr(load_backend("third"), "device_state", None, raising=False)
    with pytest.raises(CdcsrError, match="There is no GPU for device cuda here"):
        run_demo(out, tiny(1), "cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "A Card")
    monkeypatch.setattr(demo_stages, "train_on_device", learn)
    monkeypatch.setattr("training.run.device_parts.open_door", HostDoor)
    demo = Demo(out, tiny(1), engine_on_gpu(out, "auto"))
    stages = list(islice(demo.stages(), 3))
    with DEMO_FOLDER.claim(out):
        carry_out(out, stages)
    assert "BATD3 learns on A Card, in Third." in capsys.readouterr().out
    assert [(one.backend, one.device, one.preset) for one in asked] == [("third", "cuda", "gpu")]
    assert engine_on_gpu(tmp_path / "other", "cpu") is None
    # A folder keeps its device, whatever the machine has; what is finished needs none.
    with pytest.raises(CdcsrError, match="was begun with device cuda; go on with that"):
        run_demo(out, tiny(1), "cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert engine_on_gpu(out, "auto") == "third"
    (out / "runs/batd3/summary.json").unlink()
    with pytest.raises(CdcsrError, match="There is no GPU for device cuda here"):
        run_demo(out, tiny(1))
    record = out / "runs/batd3/config.json"
    write_json(record, sealed({**read_json(record), "device": "cpu"}))
    assert engine_on_gpu(out, "auto") is None


@pytest.mark.parametrize("minutes", ["0", "-1", "nan"])
def test_minutes_must_be_positive(
    tmp_path: Path, minutes: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path / "demo"), "--minutes", minutes]) == 2
    assert "minutes must be a number from 0.001 to" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()
