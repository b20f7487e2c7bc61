"""Finding engines, their options behind the name, and how many processors they may use."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import cdcsr.simulation.engines as engines
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import CdcsrError, CdcsrWarning
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import EngineOptions
from cdcsr.simulation.engines import backend_names, engine_title, processors
from tests.support.physics import with_parts


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


class _Options(EngineOptions):
    pace: int = 1
    soft: bool = False


class _Optional(MujocoSimulation):
    title = "Optional"
    options_type = _Options


class _Point:
    name, extras = "optional", ()

    def load(self) -> type[_Optional]:
        return _Optional


@pytest.fixture
def optional(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Install only an engine that has options; engines are looked up once for a `sys.path`."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        engines, "entry_points", lambda group: [_Point()] if group == "cdcsr.backends" else []
    )


@pytest.mark.usefixtures("optional")
def test_options_reach_the_engine(paper: Robot) -> None:
    plain = engines.make_simulation(paper, "optional")
    chosen = engines.make_simulation(paper, "optional:pace=3,soft=true", 2)
    assert plain.options == _Options()
    assert chosen.options == _Options(pace=3, soft=True)
    assert chosen.num == 2


@pytest.mark.usefixtures("optional")
def test_a_title_names_the_options() -> None:
    assert engines.engine_title("optional") == "Optional"
    assert engines.engine_title("optional:pace=3,soft=1") == "Optional (pace=3, soft=1)"


@pytest.mark.usefixtures("optional")
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
def test_a_wrong_option_is_one_clear_line(name: str, message: str, paper: Robot) -> None:
    with pytest.raises(CdcsrError, match=message):
        engines.load_backend(name)
    with pytest.raises(CdcsrError, match=message):
        engines.chosen_backends(name, paper)


def test_copies_in_several_engines_move_as_each_engine_alone(paper: Robot) -> None:
    names = ["mujoco", "mujoco-stock:softness=description", "pybullet"]
    mixed = engines.make_simulation(paper, "+".join(names), 5)
    owners = [names[copy % 3] for copy in range(5)]
    alone = [engines.make_simulation(paper, name) for name in owners]
    commands = np.random.default_rng(3).uniform(-0.1, 0, (6, 5, paper.num_cables))
    for command in commands:
        mixed.step(command, 10)
        for own, row in zip(alone, command, strict=True):
            own.step(row[None], 10)
    tips = [simulation.state().tip_position[0] for simulation in alone]
    assert (mixed.state().tip_position == tips).all()
    mass = [simulation.dynamics().mass_matrix[0] for simulation in alone]
    chosen = mixed.dynamics([1, 3, 4]).mass_matrix
    assert (chosen == [mass[1], mass[3], mass[4]]).all()
    assert "soft_cables" in mixed.capabilities
    assert not mixed.ideal
    for simulation in (mixed, *alone):
        simulation.close()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mujoco+", "Unknown backend ''"),
        ("mujoco+pibullet", "Did you mean 'pybullet'"),
        ("mujoco+pybullet:substeps=0", "option substeps"),
        ("mujoco+all", "Unknown backend 'all'"),
    ],
)
def test_a_wrong_name_among_several_is_one_clear_line(name: str, message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        engines.load_backend(name)


def test_commands_that_compare_engines_take_one_at_a_time(paper: Robot) -> None:
    with pytest.raises(CdcsrError, match="Choose one engine, or all"):
        engines.chosen_backends("mujoco+pybullet", paper)


def test_all_engines_are_those_that_a_robot_can_move_in(paper: Robot) -> None:
    """Stock MuJoCo has no friction in guides, and Bullet's motors are set-point servos only."""
    names = engines.chosen_backends("all", paper)
    assert {"mujoco", "mujoco-stock", "pybullet", "pybullet-stock"} <= set(names)
    for part, odd in (
        ({"cables": {"guide_friction": 0.1}}, "mujoco-stock"),
        ({"servo": {"pretension": 1.0}}, "pybullet-stock"),
    ):
        with pytest.warns(CdcsrWarning, match=rf"{odd}.*It is left out"):
            found = engines.chosen_backends("all", with_parts(paper, **part))
        assert found == [name for name in names if name != odd]
        with pytest.raises(CdcsrError, match=odd):
            engines.make_simulation(with_parts(paper, **part), odd)


def test_the_title_of_several_engines_names_each() -> None:
    assert engine_title("mujoco+pybullet:substeps=4") == "MuJoCo and PyBullet (substeps=4)"
