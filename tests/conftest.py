"""Fixtures that tests of every floor use."""

from __future__ import annotations

import pytest

from cdcsr.robot.description import Robot, load_robot


@pytest.fixture
def paper() -> Robot:
    return load_robot("paper")
