"""Every installed engine meets the contract."""

from __future__ import annotations

import pytest

from backends.contract_suite import EngineContract
from cdcsr.simulation.engines import backend_names


class TestEveryEngine(EngineContract):
    """Several engines side by side meet it too; there the copies are in one engine, because tests
    compare any copy with a simulation of one copy."""

    @pytest.fixture(params=[*backend_names(), "mujoco+mujoco"])
    def engine(self, request: pytest.FixtureRequest) -> str:
        return request.param
