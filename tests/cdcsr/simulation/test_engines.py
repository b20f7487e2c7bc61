"""Finding engines, and how many processors they may use."""

from __future__ import annotations

import os

import pytest

from cdcsr.simulation.engines import backend_names, engine_title, processors


@pytest.mark.parametrize(
    ("asked", "used"), [("1", 1), ("3", 3), ("64", 4), ("", 4), ("0", 4), ("2,1", 4)]
)
def test_no_more_than_asked_for_and_no_more_than_there_are(
    monkeypatch: pytest.MonkeyPatch, asked: str, used: int
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert processors() == used


def test_every_engine_has_a_title() -> None:
    assert [engine_title(name) for name in ("mujoco", "pybullet")] == ["MuJoCo", "PyBullet"]
    assert all(engine_title(name) for name in backend_names())
    assert engine_title("not-installed") == "not-installed"
