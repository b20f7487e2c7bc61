"""List a folder, make the lock of a dead process, an install that cannot be written, and one of
entry points."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEAD = json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "started": "0", "token": "x"})
"""The content of a lock file; no system gives out so large a process number by default."""


def names(folder: Path) -> list[str]:
    """Return all names in a folder, hidden ones included."""
    return sorted(path.name for path in folder.iterdir())


def read_only_install(folder: Path) -> dict[str, str]:
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


def install(name: str, entry_points: str, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a distribution of entry points alone, for this process and its children."""
    about = site / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Name: {name}\nVersion: 1\n")
    (about / "entry_points.txt").write_text(entry_points)
    monkeypatch.syspath_prepend(site)
    monkeypatch.setenv("PYTHONPATH", str(site))
