"""`cdcsr doctor` finds what is broken, says what to do about it, and is broken by nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cdcsr.cli import run
from cdcsr.simulation.engines import backend_names, optional_engines
from tests.support.paths import read_only_install
from training.commands import doctor as room
from training.commands.doctor import Finding, doctor


def test_nothing_here_is_a_problem_but_perhaps_opengl(tmp_path: Path) -> None:
    file = tmp_path / "doctor.json"
    code = run(doctor, "cdcsr doctor", ["--json", str(file)])
    told = json.loads(file.read_text())
    findings = [Finding(**each) for each in told["findings"]]
    assert code == (told["problems"] > 0)
    engines = {*backend_names(), *optional_engines()}
    assert {each.name for each in findings if each.part == "engines"} == engines
    assert {"processors", "compiled code", "memory", "disk", "GPU"} <= {f.name for f in findings}
    assert {each.name for each in findings if each.remedy} <= {"OpenGL (MuJoCo)"}


def test_a_broken_environment_is_told_with_remedies(tmp_path: Path) -> None:
    env = read_only_install(tmp_path / "installed") | {
        "MUJOCO_GL": "glfw",
        "OMP_NUM_THREADS": "many",
        "TMPDIR": "/dev/null/x",
    }
    env.pop("DISPLAY", None)
    for package, problem in (("torch", "no libtorch"), ("pybullet", "no libbullet")):
        module = tmp_path / "installed" / f"{package}.py"
        module.write_text(f"raise ImportError({problem!r})")
    done = subprocess.run(
        [sys.executable, "-B", "-m", "cdcsr", "doctor", "--json", "found.json"],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "Problems found: " in done.stderr.splitlines()[-1]
    told = {f["name"]: f for f in json.loads((tmp_path / "found.json").read_text())["findings"]}
    for name, found, remedy in (
        ("torch", "no libtorch", "pip install --force-reinstall torch"),
        (
            "pybullet-stock",
            "makes no step: ImportError: no libbullet",
            "the package that brings this engine",
        ),
        ("OpenGL (MuJoCo)", "does not draw (MUJOCO_GL=glfw)", "MUJOCO_GL="),
        ("processors", "OMP_NUM_THREADS=many", "Set OMP_NUM_THREADS to a whole number"),
        ("compiled code", "every process compiles anew", "Set NUMBA_CACHE_DIR"),
    ):
        assert found in told[name]["found"]
        assert remedy in told[name]["remedy"]
    assert "makes a step" in told["mujoco"]["found"]


def test_the_platform_that_draws_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(room, "_draws", lambda platform: "" if platform == "osmesa" else "no EGL")
    finding = next(room._rendering())
    assert finding.found == "does not draw (MUJOCO_GL is not set): no EGL"
    assert finding.remedy.startswith("Set MUJOCO_GL=osmesa, which draws here;")
