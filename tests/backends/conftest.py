"""Every engine and every shipped robot, for the tests of what holds in all of them."""

from __future__ import annotations

import pytest

from cdcsr.robot import Robot, load_robot, shipped_robots
from cdcsr.simulation import backend_names


@pytest.fixture(params=backend_names())
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def paper() -> Robot:
    return load_robot("paper")
