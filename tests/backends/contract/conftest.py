"""The contract holds for several engines side by side too.

The copies are in one engine here, because tests compare any copy with a simulation of one copy.
"""

from __future__ import annotations

import pytest

from cdcsr.simulation.engines import backend_names


@pytest.fixture(params=[*backend_names(), "mujoco+mujoco"])
def engine(request: pytest.FixtureRequest) -> str:
    return request.param
