"""The example of an engine of one's own meets the contract, tested as docs/your-own-engine.md tells
it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from backends.contract_suite import EngineContract
from backends.contract_suite.states import commands_of, running
from cdcsr.robot.description import Robot
from examples.own_engine import NumpySimulation
from tests.support.paths import ROOT, install


@pytest.mark.slow
class TestOwnEngine(EngineContract):
    backend = "numpy"

    @pytest.fixture(autouse=True)
    def _installed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        points = "[cdcsr.backends]\nnumpy = examples.own_engine:NumpySimulation\n"
        install("own_engine", points, tmp_path / "site", monkeypatch)


def test_it_moves_as_mujoco_does(paper: Robot) -> None:
    """It solves the same equation by another method."""
    own = NumpySimulation(paper, 2)
    with running(paper, "mujoco", 2) as other:
        for command in commands_of(paper, 60, 2):
            own.step(command)
            other.step(command)
        found, expected = own.state(), other.state()
    own.close()
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.cable_tension, expected.cable_tension, rtol=0, atol=0.1)
    assert expected.cable_tension.max() > 100


def test_it_has_at_most_100_lines_of_code() -> None:
    lines = (ROOT / "examples" / "own_engine.py").read_text("utf-8").splitlines()
    assert len([line for line in lines if line]) <= 100
