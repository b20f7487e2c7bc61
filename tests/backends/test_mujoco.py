"""What is MuJoCo's own: threads, arrays shared with the engine, divergence. The physics is tested in every engine."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import Diverged
from cdcsr.robot import Robot
from physics import commands_of


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its warnings to a file in the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("threads", [1, 2])
def test_each_copy_moves_as_if_alone(paper: Robot, threads: int) -> None:
    commands = commands_of(paper, 60, num=9)
    batch = MujocoSimulation(paper, 9, threads=threads)
    for command in commands:
        batch.step(command, 2)
    together = batch.state()
    for copy in (0, 4, 8):
        alone = MujocoSimulation(paper)
        for command in commands:
            alone.step(command[copy : copy + 1], 2)
        for field in dataclasses.fields(together):
            np.testing.assert_array_equal(getattr(alone.state(), field.name)[0], getattr(together, field.name)[copy])


def test_a_state_stays_as_it_was(paper: Robot) -> None:
    simulation = MujocoSimulation(paper)
    state = simulation.state()
    before = dataclasses.replace(state, **{f.name: getattr(state, f.name).copy() for f in dataclasses.fields(state)})
    simulation.step(commands_of(paper, 1)[0], 50)
    for field in dataclasses.fields(state):
        np.testing.assert_array_equal(getattr(state, field.name), getattr(before, field.name))


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("bad", [1e6, np.nan])
def test_divergence_names_copy_and_time(paper: Robot, bad: float) -> None:
    simulation = MujocoSimulation(paper, 4)
    command = np.zeros((4, paper.num_cables))
    simulation.step(command, 10)
    snapshot = simulation.get_snapshot()
    velocity = np.zeros_like(snapshot.velocity)
    velocity[2, 0] = bad
    simulation.set_snapshot(dataclasses.replace(snapshot, engine="by hand", velocity=velocity))
    with pytest.raises(Diverged, match=r"mujoco: copy 2 diverged at t = 0\.0275 s") as caught:
        simulation.step(command)
    assert (caught.value.copy, caught.value.time) == (2, pytest.approx(0.0275))


@pytest.mark.usefixtures("elsewhere")
def test_an_impossible_time_step_diverges(paper: Robot) -> None:
    coarse = paper.model_dump() | {"time_step": 0.5, "constraint": {"recovery_time": 1.0}}
    simulation = MujocoSimulation(Robot.model_validate(coarse))
    with pytest.raises(Diverged, match="smaller time_step"):
        simulation.step(commands_of(paper, 1)[0], 2000)
