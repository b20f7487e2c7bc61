"""Parameters last through resets and snapshots, can be set back, and reach workers; impossible ones
are errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import ArrayLike

from backends.mujoco.simulation import MujocoSimulation
from backends.pybullet.simulation import PybulletSimulation
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.delay_line import MAX_DELAY
from cdcsr.simulation.plant import Parameters
from tests.support.physics import Make, assert_same, commands_of, random_parameters


def test_reset_keeps_parameters_and_snapshots_continue(
    make: Make, engine: str, paper: Robot
) -> None:
    parameters = dataclasses.replace(random_parameters(paper, 2), command_delay=[0, 3])
    commands = commands_of(paper, 40, 2, hold=10)
    first, second = make(engine, paper, 2), make(engine, paper, 2)
    for simulation in (first, second):
        simulation.set_parameters(None, parameters)
        simulation.reset()
    for command in commands:
        first.step(command)
    first.reset([1])
    first.reset([0])
    tolerance = 0.0 if engine == "mujoco" else 1e-10
    for command in commands:
        first.step(command)
        second.step(command)
    assert_same(first.get_snapshot(), second.get_snapshot(), atol=tolerance)
    snapshot = first.get_snapshot()
    for command in commands:
        first.step(command)
    second.reset()
    second.set_snapshot(snapshot)
    for command in commands:
        second.step(command)
    assert_same(first.get_snapshot(), second.get_snapshot(), atol=tolerance)


def test_default_parameters_restore_the_first_bits(make: Make, engine: str, paper: Robot) -> None:
    commands = commands_of(paper, 30, 2, hold=10)
    plain, back = make(engine, paper, 2), make(engine, paper, 2)
    back.set_parameters(None, dataclasses.replace(random_parameters(paper, 2), command_delay=2))
    back.set_parameters([0], Parameters())
    back.set_parameters([1], Parameters())
    for command in commands:
        plain.step(command)
        back.step(command)
        assert_same(plain.get_snapshot(), back.get_snapshot())
    assert back.get_snapshot().commands is None
    for ours, theirs in zip(back.plant, plain.plant, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_workers_and_threads_have_the_parameters_too(paper: Robot) -> None:
    num = 5
    parameters = dataclasses.replace(random_parameters(paper, 3), command_delay=[2, 0, 1])
    pairs = [
        (MujocoSimulation(paper, num, threads=1), MujocoSimulation(paper, num, threads=2)),
        (PybulletSimulation(paper, num, workers=0), PybulletSimulation(paper, num, workers=2)),
    ]
    for pair in pairs:
        for simulation in pair:
            simulation.set_parameters([0, 2, 4], parameters)
            for command in commands_of(paper, 20, num, hold=10):
                simulation.step(command, 2)
        assert_same(pair[0].state(), pair[1].state())
        assert_same(pair[0].dynamics([4]), pair[1].dynamics([4]))
        for simulation in pair:
            simulation.close()


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (
            {"link_mass": np.ones(12)},
            r"link_mass must be a number or have the shape \(2,\) or \(2, 12\), not \(12,\)",
        ),
        ({"link_mass": 0.0}, "link_mass must be positive; found 0"),
        ({"servo_gain": [1.0, -1.0]}, "servo_gain must be positive; found -1"),
        ({"joint_damping": -0.5}, "joint_damping must be zero or positive; found -0.5"),
        (
            {"base_inertia": np.ones((2, 3))},
            r"base_inertia must be a number or have the shape \(2,\) or \(2, 1\)",
        ),
        ({"joint_stiffness": np.nan}, "joint_stiffness must be finite"),
        ({"base_mass": "heavy"}, "base_mass must be a number or an array of numbers"),
        ({"rest_length_offset": -0.2}, "rest_length_offset must be at least -0.19 m"),
        ({"command_delay": 1.5}, "command_delay counts whole steps, from 0 to"),
        ({"command_delay": -1}, "command_delay counts whole steps, from 0 to"),
        ({"command_delay": MAX_DELAY + 1}, "command_delay counts whole steps, from 0 to"),
        (
            {"command_delay": [1, 2, 3]},
            r"command_delay must be a number or have the shape \(2,\), not \(3,\)",
        ),
    ],
)
def test_impossible_parameters_are_errors_and_change_nothing(
    make: Make, paper: Robot, bad: dict[str, ArrayLike], message: str
) -> None:
    simulation = make("mujoco", paper, 3)
    before = [part.copy() for part in simulation.plant]
    with pytest.raises(CdcsrError, match=message):
        simulation.set_parameters([0, 2], Parameters(**{"base_mass": 2.0} | bad))
    for part, was in zip(simulation.plant, before, strict=True):
        np.testing.assert_array_equal(part, was)


def test_an_empty_list_of_copies_is_no_error(make: Make, engine: str, paper: Robot) -> None:
    simulation = make(engine, paper, 2)
    before = simulation.get_snapshot()
    simulation.set_parameters([], random_parameters(paper, 0))
    simulation.set_parameters([], Parameters(command_delay=np.zeros(0, int)))
    assert_same(simulation.get_snapshot(), before)


def test_damping_and_stiffness_may_be_zero(make: Make, engine: str, paper: Robot) -> None:
    simulation = make(engine, paper)
    simulation.set_parameters(
        None, Parameters(joint_damping=0, joint_stiffness=0, slider_damping=0)
    )
    simulation.step(commands_of(paper, 1, hold=10)[0])
    assert not simulation.dynamics().passive_force.any()
