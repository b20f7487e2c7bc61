"""The class of tests that :mod:`backends.contract_suite` hands out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from backends.contract_suite.copies import CopiesContract
from backends.contract_suite.life import LifeContract
from backends.contract_suite.parameters import ParametersContract
from backends.contract_suite.states import KINDS, Make, simulations
from cdcsr.robot.description import Robot, load_robot


class EngineContract(CopiesContract, LifeContract, ParametersContract):
    """Tests that every engine passes; a subclass names the engine.

    They need nothing but pytest, and take about a minute for a fast engine.
    """

    backend: ClassVar[str]
    """The engine's name, with options or without, as for `--backend`."""

    @pytest.fixture
    def engine(self) -> str:
        """Return the name; a subclass may replace this by a fixture of several names."""
        return self.backend

    @pytest.fixture
    def paper(self) -> Robot:
        """Return the robot of most tests."""
        return load_robot("paper")

    @pytest.fixture(params=KINDS)
    def robot(self, request: pytest.FixtureRequest) -> Robot:
        """Return robots of every kind."""
        return load_robot(request.param)

    @pytest.fixture
    def make(self) -> Iterator[Make]:
        """Yield what makes simulations, which are closed at the end of the test."""
        with simulations() as make:
            yield make
