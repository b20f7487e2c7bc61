"""Fixtures of every engine and every shipped robot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from backends.contract_suite.states import KINDS, Make, simulations
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import backend_names, load_backend


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave most physics of `pybullet-stock` to the slow tests: it shares its kernels with
    `pybullet`, and the contract's tests have it with every robot."""
    for item in items:
        given = getattr(item, "callspec", None)
        if given is None or "tests/backends/physics/" not in item.nodeid:
            continue
        engines = [value for name, value in given.params.items() if name.endswith("engine")]
        if "pybullet-stock" in str(engines) and given.params.get("robot") != "planar-single":
            item.add_marker(pytest.mark.slow)


@pytest.fixture(params=backend_names())
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


UNDAMPED = [name for name in backend_names() if name != "pybullet-stock"] + [
    "pybullet-stock:damping=0,servo=force"
]


@pytest.fixture(params=UNDAMPED)
def undamped_engine(request: pytest.FixtureRequest) -> str:
    """An engine without damping and motors of its own."""
    return request.param


@pytest.fixture(params=[n for n in UNDAMPED if "soft_cables" not in load_backend(n).capabilities])
def stiff_engine(request: pytest.FixtureRequest) -> str:
    """An undamped engine whose cables do not stretch, and so take no energy."""
    return request.param


@pytest.fixture(params=KINDS)
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def make() -> Iterator[Make]:
    """Make simulations, and close them at the end of the test."""
    with simulations() as make:
        yield make


@pytest.fixture
def server() -> Iterator[Any]:
    """Start a server of pages, which shows nothing yet."""
    from backends.viewers.web import LocalServer

    made = LocalServer("127.0.0.1", 0, verbose=False)
    yield made
    made.stop()
