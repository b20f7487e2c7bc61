"""Compiled functions work where nothing may be written, and are kept where it may."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import read_only_install

KERNELS = """
import numpy as np
from backends.pybullet import cables, lcp, world
from training.networks.ensemble_kernels import rectify
x = np.array([[1.0, -2.0]])
rectify(x, np.array([0.5, 0.5]))
print(x.tolist(), lcp.factor.stats.cache_path)
"""


def _printed(code: str, folder: Path, environment: dict[str, str]) -> str:
    """Return what code prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-B", "-c", code],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("home", ["none", "cache folder"])
def test_kernels_run_from_a_read_only_install(home: str, tmp_path: Path) -> None:
    env = read_only_install(tmp_path / "installed")
    if home == "cache folder":
        env["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    numbers, _, place = _printed(KERNELS, tmp_path, env).rpartition(" ")
    assert numbers == "[[1.5, 0.0]]"
    assert place.startswith(env.get("NUMBA_CACHE_DIR", "None")), place


CALLEES = """
from cdcsr.compiled import compiled
from own.numbers import STEP

@compiled()
def twice(x):
    return FACTOR * x + STEP
"""
CALLER = """
from cdcsr.compiled import compiled
from own.callees import twice

@compiled()
def result(x):
    return twice(x) + 1
"""


def test_a_changed_callee_or_constant_is_compiled_into_its_callers(tmp_path: Path) -> None:
    """Numba by itself goes on with the machine code of the caller, whose file has not changed."""
    package = tmp_path / "own"
    package.mkdir()
    (package / "caller.py").write_text(CALLER, "utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *sys.path])
    found = []
    for factor, step in ((2, 0), (2, 0), (3, 0), (3, 100)):
        (package / "numbers.py").write_text(f"STEP = {step}\n", "utf-8")
        text = CALLEES.replace("FACTOR", str(factor))
        (package / "callees.py").write_text(text, "utf-8")
        told = "from own.caller import result as f; print(f(5), sum(f.stats.cache_hits.values()))"
        found.append(_printed(told, tmp_path, environment).split())
    assert found == [["11", "0"], ["11", "1"], ["16", "0"], ["116", "0"]]
