"""Compiled functions work where nothing may be written, and are kept where it may."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
KERNELS = """
import numpy as np
from backends.pybullet import cables, lcp, world
from training.networks.ensemble_kernels import rectify
x = np.array([[1.0, -2.0]])
rectify(x, np.array([0.5, 0.5]))
print(x.tolist(), lcp.factor.stats.cache_path)
"""


def install(folder: Path) -> dict[str, str]:
    """Copy the packages to where they cannot be written; return an environment without a home.

    Files stand where Python would put compiled code, so that root cannot write there either.
    """
    for package in ("cdcsr", "backends", "controllers", "training"):
        place = shutil.copytree(
            ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__")
        )
        for each in (place, *(path for path in place.rglob("*") if path.is_dir())):
            (each / "__pycache__").touch()
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    return {**kept, "PYTHONPATH": str(folder), "HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/x"}


@pytest.mark.parametrize("home", ["none", "cache folder"])
def test_kernels_run_from_a_read_only_install(home: str, tmp_path: Path) -> None:
    env = install(tmp_path / "installed")
    if home == "cache folder":
        env["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    done = subprocess.run(
        [sys.executable, "-B", "-c", KERNELS],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    numbers, _, place = done.stdout.strip().rpartition(" ")
    assert numbers == "[[1.5, 0.0]]"
    assert place.startswith(env.get("NUMBA_CACHE_DIR", "None")), place
