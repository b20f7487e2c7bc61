"""Every installed engine meets the contract, and so does the example of an engine of one's own,
tested as docs/your-own-engine.md tells it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from backends.contract_suite import EngineContract
from backends.contract_suite.states import commands_of, running
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import backend_names
from examples.own_engine import NumpySimulation
from tests.support.paths import ROOT, install


class TestEveryEngine(EngineContract):
    """Several engines side by side meet it too; there the copies are in one engine, because tests
    compare any copy with a simulation of one copy."""

    @pytest.fixture(params=[*backend_names(), "mujoco+mujoco"])
    def engine(self, request: pytest.FixtureRequest) -> str:
        return request.param


@pytest.mark.slow
class TestOwnEngine(EngineContract):
    backend = "numpy"

    @pytest.fixture(autouse=True)
    def _installed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        points = "[cdcsr.backends]\nnumpy = examples.own_engine:NumpySimulation\n"
        install("own_engine", points, tmp_path / "site", monkeypatch)


def test_the_own_engine_moves_as_mujoco_does(paper: Robot) -> None:
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


def test_the_own_engine_has_at_most_100_lines_of_code() -> None:
    lines = (ROOT / "examples" / "own_engine.py").read_text("utf-8").splitlines()
    assert len([line for line in lines if line]) <= 100
