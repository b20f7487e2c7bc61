"""`cdcsr engines` lists every engine, also a broken one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr.cli import run
from cdcsr.simulation import engines as registry
from training.commands.engines import engines
from training.commands.validate import validate


def test_every_engine_says_what_is_its_own_and_what_a_step_costs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "engines.json"
    engines(robot="planar-single", json=file)
    found = json.loads(file.read_text())
    assert set(found) == set(registry.backend_names())
    shown = capsys.readouterr().out
    assert "option substeps" in shown
    for name, row in found.items():
        assert name in shown
        assert "not declared" not in row["physics"].values()
        assert 1 < row["step_us"]["1"] < 1e5
    assert found["pybullet"]["physics"]["joint_dynamics"].startswith("Bullet")
    assert found["pybullet-stock"]["options"]["damping"]["default"] == 0.04


def test_a_broken_engine_is_listed_with_its_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(name: str) -> None:
        raise ImportError(f"no library for {name}")

    monkeypatch.setattr(registry, "load_backend", broken)
    engines(robot="planar-single")
    assert "mujoco: cannot be loaded: ImportError: no library for mujoco" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["cosserat", "missing"], "missing"),
        (
            ["cosserat", ".", "--links", "0"],
            "A number of links must be a whole number from 1 to 500, not 0",
        ),
    ],
)
def test_validate_ends_in_one_clear_line(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(validate, "cdcsr validate", options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
