"""An engine of three lines, installed beside the others, appears wherever engines are listed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names, engine_title, make_simulation
from controllers.jacobian import JacobianController
from training.bench.sections import run_sections
from training.commands.build_model import build_model
from training.commands.parity import parity
from training.config.run_description import RunDescription
from training.study.execute.evaluations import Subject, nominal

pytestmark = pytest.mark.usefixtures("third_engine")
ALL = ["mujoco", "mujoco-stock", "pybullet", "pybullet-stock", "third"]


def test_it_is_found_by_name() -> None:
    assert backend_names() == ALL
    assert engine_title("third") == "Third"
    simulation = make_simulation(load_robot("paper"), "third", 2)
    assert (simulation.engine, simulation.num) == ("third", 2)
    simulation.close()


def test_build_model_compares_it_and_says_that_it_has_no_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, summary = tmp_path / "out", tmp_path / "summary.json"
    build_model("planar-single", out=out, json=summary)
    printed = capsys.readouterr().out
    assert "Third has no model files of its own\n" in printed
    assert "MuJoCo, stock has no model files of its own; it runs those of MuJoCo\n" in printed
    assert {"planar-single.xml", "planar-single.urdf"} <= {path.name for path in out.iterdir()}
    found = json.loads(summary.read_text())
    assert found["backends"] == ALL
    assert found["mass_matrix_difference"]["third"] == {"straight": 0.0, "bent": 0.0}


def test_build_model_writes_what_no_engine_is_needed_for(tmp_path: Path) -> None:
    build_model("planar-single", out=tmp_path / "out", backend="third")
    names = {path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")}
    assert names == {"meshes", "planar-single.glb", "planar-single.toml"}


def test_parity_compares_it(tmp_path: Path) -> None:
    file = tmp_path / "parity.json"
    parity("planar-single", backend="third", episodes=1, json=file)
    found = json.loads(file.read_text())
    assert found["engines"] == ["mujoco", "third"]
    assert found["open_loop"][0]["tip_distance"]["third"]["max"] == [0.0] * 4


def test_bench_measures_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its own section, and its row in a section of all engines."""
    monkeypatch.setattr("training.bench.memory.memory_per_copy", lambda *_: 1.5)
    file = tmp_path / "bench.json"
    run_sections(("third-own", "memory"), file, plot=None, peers=None)
    found = json.loads(file.read_text())
    assert found["third_copies"] == 8
    assert "a line" in capsys.readouterr().out
    measured = [name for name in found if name.startswith("memory_")]
    assert measured == ["memory_mujoco", "memory_pybullet", "memory_third"]  # no variants


def test_the_study_measures_in_it() -> None:
    robot = load_robot("paper")
    subject = Subject(
        RunDescription(algorithm="jacobian", space="anchor"), JacobianController(robot), robot
    )
    rows = list(nominal(subject, 1))
    assert [row[0] for row in rows if row[1] == "anchor"] == ALL
