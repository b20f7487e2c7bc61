"""Where a package is missing the rest works, and what needs it says in one line what to do."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest

_PROGRAM = """
import sys
blocked, *lines = sys.argv[1:]
class Missing:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in blocked.split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing)
from cdcsr.cli import main
print(*(main(line.split()) for line in lines), file=open("codes", "w"))
"""


def run(blocked: str, folder: Path, lines: Sequence[str]) -> tuple[list[int], str, list[str]]:
    """Run commands in a process that lacks modules.

    Returns:
        Their exit codes, what they print, and the lines of errors and warnings.
    """
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, blocked, *lines],
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert "Traceback" not in done.stderr, done.stderr
    codes = [int(code) for code in (folder / "codes").read_text().split()]
    return codes, done.stdout, [line for line in done.stderr.splitlines() if line[:7] == "cdcsr: "]


def test_without_torch_what_learns_says_so_and_the_rest_works(tmp_path: Path) -> None:
    scripted = "evaluate jacobian --episodes 1 --backend mujoco"
    learned = "evaluate batd3-spatter-mujoco --episodes 1"
    lines = [scripted, learned, "train --out run", "--help"]
    # Nothing is drawn, so nothing may wait for the import of trimesh, half of an engine's start.
    codes, out, said = run("torch,trimesh", tmp_path, lines)
    assert codes == [0, 2, 2, 0]
    assert "| jacobian" in out
    assert said == [
        f"cdcsr: error: `cdcsr {name}` needs the package torch, which is not installed: "
        "pip install torch."
        for name in ("evaluate", "train")
    ]


def test_without_pybullet_mujoco_works_and_what_is_left_out_is_told(tmp_path: Path) -> None:
    build, asked = "build-model planar-single --out model", "build-model paper --out other"
    codes, _, said = run("pybullet", tmp_path, [build, f"{asked} --backend pybullet"])
    assert codes == [0, 2]
    assert (tmp_path / "model" / "planar-single.xml").exists()
    assert not list((tmp_path / "model").glob("*.urdf"))
    assert not (tmp_path / "other").exists()
    needs = "needs the package pybullet, which is not installed: pip install pybullet."
    assert said == [
        f"cdcsr: warning: The engine pybullet {needs} It is left out.",
        f"cdcsr: warning: The engine pybullet-stock {needs} It is left out.",
        f"cdcsr: error: The engine pybullet {needs}",
    ]


@pytest.mark.skipif(find_spec("mujoco_warp") is not None, reason="the extra gpu is installed")
def test_without_its_extra_the_gpu_engine_is_left_out_silently_and_says_what_it_needs(
    tmp_path: Path,
) -> None:
    """Nobody who has no GPU should be told about it with each command."""
    build = "build-model planar-single --out model --json model.json"
    lines = [
        build,
        "evaluate jacobian --episodes 1 --backend warp",
        "evaluate jacobian --backend x",
    ]
    codes, _, said = run("none", tmp_path, lines)
    assert codes == [0, 2, 2]
    assert "warp" not in json.loads((tmp_path / "model.json").read_text())["backends"]
    assert said[0] == (
        "cdcsr: error: The engine warp needs the package warp-lang, which is not installed: "
        "pip install warp-lang."
    )
    assert said[1].startswith("cdcsr: error: Unknown backend 'x'.")


@pytest.mark.slow
@pytest.mark.parametrize("blocked", ["mujoco", "pybullet", "torch"])
def test_whatever_is_missing_the_first_commands_work(blocked: str, tmp_path: Path) -> None:
    lines = ["engines", "doctor", "build-model paper --out model", "new-robot arm", "--help"]
    codes, out, said = run(blocked, tmp_path, lines)
    needs_mujoco = 2 if blocked == "mujoco" else 0  # the demonstrator tries a new arm there
    assert codes == [0, 1, 0, needs_mujoco, 0]
    assert f"! pip install {blocked}" in out
    assert any("Problems found" in line for line in said)
    assert (tmp_path / "model" / "paper.toml").exists()


@pytest.mark.slow
def test_without_any_engine_commands_name_what_to_install(tmp_path: Path) -> None:
    lines = ["engines", "build-model paper --out model"]
    codes, out, said = run("mujoco,pybullet", tmp_path, lines)
    assert codes == [0, 2]
    assert "pybullet: cannot be loaded: The engine pybullet needs the package pybullet" in out
    assert len(said) == 1
    assert "No engine can be used. The engine mujoco needs the package mujoco" in said[0]
