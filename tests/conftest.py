"""Fixtures that tests of every floor use."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import pytest

from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation import engines
from tests.support.paths import install

# Tests start dozens of processes that import engines or torch. Where Python is told to keep no
# bytecode, as in many containers, each of them would compile thousands of modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# An engine of an extra has tests of its own, as in tests/backends/warp. No other test should depend
# on whether the extra is installed, nor compile for minutes.
engines._complete = lambda point: not point.extras

_ENGINE = """
from backends.mujoco.simulation import MujocoSimulation
class ThirdSimulation(MujocoSimulation):
    engine, title = "third", "Third"
"""
_MEASUREMENT = """
from cdcsr.simulation.benchmarks import Measurement
def measure(robot, commands):
    yield Measurement("third_copies", commands.shape[0], "episodes given", lines=("a line",))
"""
_ENTRY_POINTS = """
[cdcsr.backends]
third = third_engine:ThirdSimulation
[cdcsr.benchmarks]
third-own = third_engine:measure
"""


def pytest_collection_finish() -> None:
    """Take what is imported by now, a million objects, out of every later garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def paper() -> Robot:
    return load_robot("paper")


@pytest.fixture
def third_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install an engine of three lines, for this process and its children."""
    site = tmp_path / "site"
    install("third_engine", _ENTRY_POINTS, site, monkeypatch)
    (site / "third_engine.py").write_text(_ENGINE + _MEASUREMENT)
    monkeypatch.delitem(sys.modules, "third_engine", raising=False)
