"""Options of an engine, written behind its name."""

from __future__ import annotations

import pytest

import cdcsr.simulation.engines as engines
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import EngineOptions


class _Options(EngineOptions):
    pace: int = 1
    soft: bool = False


class _Optional(MujocoSimulation):
    title = "Optional"
    options_type = _Options


class _Point:
    name = "optional"

    def load(self) -> type[_Optional]:
        return _Optional


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        engines, "entry_points", lambda group: [_Point()] if group == "cdcsr.backends" else []
    )
    engines.engine_title.cache_clear()


def test_options_reach_the_engine(paper: Robot) -> None:
    plain = engines.make_simulation(paper, "optional")
    chosen = engines.make_simulation(paper, "optional:pace=3,soft=true", 2)
    assert plain.options == _Options()
    assert chosen.options == _Options(pace=3, soft=True)
    assert chosen.num == 2


def test_a_title_names_the_options() -> None:
    assert engines.engine_title("optional") == "Optional"
    assert engines.engine_title("optional:pace=3,soft=1") == "Optional (pace=3, soft=1)"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("optional:pase=3", "Unknown option of the engine optional 'pase'. Did you mean 'pace'"),
        ("optional:pace=x", "option pace: .* found 'x'"),
        ("optional:pace", "written name:key=value"),
        ("optional:pace=1,pace=2", "each key once"),
        ("optional:", "written name:key=value"),
        ("optionel:pace=1", "Unknown backend 'optionel'. Did you mean 'optional'"),
    ],
)
def test_a_wrong_option_is_one_clear_line(name: str, message: str) -> None:
    for find in (engines.load_backend, lambda text: engines.chosen_backends(text)):
        with pytest.raises(CdcsrError, match=message):
            find(name)
