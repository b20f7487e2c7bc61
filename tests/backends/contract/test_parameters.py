"""Parameters of parts in the engines of this package, and impossible ones, which all refuse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import ArrayLike

from backends.contract_suite.parameters import PLACES, STEPS
from backends.contract_suite.states import Make, assert_same, commands_of, random_parameters
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.delay_line import MAX_DELAY
from cdcsr.simulation.plant import Parameters


@pytest.mark.parametrize("factor", [0.7, 1.4])
@pytest.mark.parametrize(
    "name", ["base_mass", "base_inertia", "link_mass", "link_inertia", "joint_damping"]
)
def test_heavier_and_lighter_parts_are_as_if_written(
    make: Make, paper: Robot, name: str, factor: float
) -> None:
    """MuJoCo makes constraints softer or harder by masses, and must do it again if one changes,
    up or down."""
    section, key = PLACES[name]
    data = paper.model_dump()
    tables = [data["base"]] if section == "base" else [s[section] for s in data["segments"]]
    for table in tables:
        table[key] = (np.array(table[key]) * factor).tolist()
    copy, described = make("mujoco", paper), make("mujoco", Robot.model_validate(data))
    parts = 1 if section == "base" else paper.num_links
    copy.set_parameters(None, Parameters(**{name: np.full((1, parts), factor)}))
    for command in commands_of(paper, 30, 1, hold=10):
        copy.step(command)
        described.step(command)
    np.testing.assert_array_equal(copy.get_snapshot().position, described.get_snapshot().position)


def test_engines_move_alike_with_the_same_parameters(make: Make, paper: Robot) -> None:
    """They are as near to each other as without parameters; the parameters move the tip much
    further."""
    parameters, tips = random_parameters(paper, 2), {}
    for differ in (False, True):
        for engine in ("mujoco", "pybullet"):
            simulation = make(engine, paper, 2)
            if differ:
                simulation.set_parameters(None, parameters)
            for command in commands_of(paper, STEPS, 2, hold=10):
                simulation.step(command)
            tips[engine, differ] = simulation.state().tip_position
    apart = {
        d: np.linalg.norm(tips["mujoco", d] - tips["pybullet", d], axis=1).max()
        for d in (False, True)
    }
    moved = np.linalg.norm(tips["mujoco", True] - tips["mujoco", False], axis=1).min()
    assert apart[True] < 3 * apart[False] + 1e-3
    assert moved > 5 * apart[True]


def test_threads_have_the_parameters_too(paper: Robot) -> None:
    num = 5
    parameters = dataclasses.replace(random_parameters(paper, 3), command_delay=[2, 0, 1])
    pair = [MujocoSimulation(paper, num, threads=count) for count in (1, 2)]
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
