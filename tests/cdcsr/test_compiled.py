"""Compiled functions work where nothing may be written, and are kept where it may."""

from __future__ import annotations

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


@pytest.mark.parametrize("home", ["none", "cache folder"])
def test_kernels_run_from_a_read_only_install(home: str, tmp_path: Path) -> None:
    env = read_only_install(tmp_path / "installed")
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
