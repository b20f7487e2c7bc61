"""Every engine and every shipped robot, for the tests of what holds in all of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from cdcsr.robot.description import Robot, load_robot, shipped_robots
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import backend_names, load_backend
from tests.support.physics import Make


@pytest.fixture(params=backend_names())
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def make() -> Iterator[Make]:
    """Makes simulations in the engine of a name, and closes them."""
    made: list[Simulation] = []

    def simulation(engine: str, *arguments: Any, **options: Any) -> Simulation:
        made.append(load_backend(engine)(*arguments, **options))
        return made[-1]

    yield simulation
    for each in made:
        each.close()
