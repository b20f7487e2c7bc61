"""Engines as parameters of tests."""

from __future__ import annotations

from typing import Any

import pytest

from cdcsr.simulation.engines import backend_names, principal_engines


def each_engine(*case: object) -> list[Any]:  # parameters of pytest have no public type
    """Return a parameter for each engine, after the other ones of a case.

    Variants of another engine are left to the slow tests: this is for what lies above the engines.
    """
    principal = principal_engines()
    return [
        pytest.param(*case, name, marks=() if name in principal else pytest.mark.slow)
        for name in backend_names()
    ]
