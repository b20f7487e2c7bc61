"""Elastic cables are springs that only pull: T L / (E A) at rest, no energy out of nothing, and
stiff ones are cables that do not stretch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from backends.contract_suite.states import commands_of, running, straight
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.declarations import check_abilities
from cdcsr.simulation.plant import Parameters
from tests.backends.physics.test_statics import settling, taken_in
from tests.support.physics import changed, elastic_stiffness, energy, finer, slack, with_parts


def elastic(robot: Robot, stiffness: float) -> Robot:
    """Return the robot with cables of an axial stiffness E A, in [N]."""
    return with_parts(robot, cables={"axial_stiffness": stiffness})


def test_an_arm_at_rest_has_the_least_energy_with_its_cables_as_springs(engine: str) -> None:
    """A servo and its cable are springs in series, k = 1 / (1/g + L / (E A)), between the set-point
    and what the arm takes in. The cable is longer than at rest by T L / (E A)."""
    robot = elastic(settling(load_robot("planar-single")), 1500.0)
    command = np.array([-0.5, -0.1, -0.2, 0.0])
    springs, gain = elastic_stiffness(robot), robot.segments[0].servo.gain
    series = 1 / (1 / gain + 1 / springs)
    stiffness = np.array([hinge.stiffness for hinge in robot.hinges])

    def terms(hinges: Array) -> Array:
        pulled = np.maximum(taken_in(robot, hinges) - command, 0)
        return np.concatenate([np.sqrt(stiffness) * hinges, np.sqrt(series) * pulled])

    hinges = least_squares(terms, np.zeros(robot.num_hinges), xtol=1e-15, ftol=1e-15).x
    tension = series * np.maximum(taken_in(robot, hinges) - command, 0)
    assert tension.max() > 15  # N, so that the cable is 15 mm longer
    with running(robot, engine) as simulation:
        simulation.step(command[None], 4000)
        state, longer = simulation.state(), -slack(robot, simulation)[0]
    np.testing.assert_allclose(state.joint_angles[0], hinges, atol=1e-4)
    np.testing.assert_allclose(state.cable_tension[0], tension, atol=1e-2)
    np.testing.assert_allclose(longer[tension > 0], (tension / springs)[tension > 0], atol=1e-5)


@pytest.mark.parametrize("divide", [1, 4])
def test_under_held_commands_the_energy_only_falls(divide: int, engine: str) -> None:
    robot = finer(elastic(load_robot("planar-single"), 2e4), divide)
    command = commands_of(robot, 1)[0]
    with running(robot, engine) as simulation:
        start = lowest = energy(robot, simulation, command)[0]
        for _ in range(160 * divide):
            simulation.step(command)
            now = energy(robot, simulation, command)[0]
            assert now <= lowest + 1e-12 * start
            lowest = min(lowest, now)
    assert lowest < 0.999 * start


@pytest.mark.parametrize("name", ["mujoco", "pybullet"])
def test_stiffer_cables_come_near_those_that_do_not_stretch(name: str) -> None:
    """The distance falls as 1 / (E A), at any stiffness: the springs are implicit."""
    rigid, places = load_robot("paper"), []
    for stiffness in (1e7, 1e8, 1e9, None):
        robot = rigid if stiffness is None else elastic(rigid, stiffness)
        with running(robot, name) as simulation:
            for command in commands_of(rigid, 200):
                simulation.step(command)
            places.append(simulation.state().tip_position[0])
    off = [np.linalg.norm(place - places[-1]) for place in places[:-1]]
    assert off[0] < 3e-3
    assert off[1] < off[0] / 5
    assert off[2] < off[1] / 5


def test_the_plant_makes_cables_elastic_and_rigid(engine: str) -> None:
    """`cable_strain` adds to 1 / (E A); copies have their own."""
    rigid = changed(load_robot("planar-single"), time_step=0.001)
    soft = elastic(rigid, 1e4)
    plants = {
        "rigid": (rigid, 0.0),
        "soft": (soft, 0.0),
        "added": (rigid, [0, 1e-4]),
        "taken off": (soft, [-1e-4, 0]),
    }
    ends = {}
    for name, (robot, strain) in plants.items():
        with running(robot, engine, 2) as simulation:
            simulation.set_parameters(None, Parameters(cable_strain=strain))
            simulation.set_snapshot(straight(robot, 2))
            for command in commands_of(rigid, 100, 2):
                simulation.step(command[[0, 0]])
            ends[name] = simulation.state().tip_position
    apart = float(np.linalg.norm(ends["rigid"][0] - ends["soft"][0]))
    assert apart > 1e-3
    for name in ("added", "taken off"):
        expected = [ends["rigid"][0], ends["soft"][0]]
        np.testing.assert_allclose(ends[name], expected, rtol=0, atol=1e-3 * apart)


def test_an_engine_without_elastic_cables_refuses_them() -> None:
    robot = elastic(load_robot("paper"), 1e5)
    with pytest.raises(CdcsrError, match="third has no elastic cables"):
        check_abilities("third", frozenset(), robot, Parameters().plant(robot, 1))


def test_a_cable_cannot_be_stiffer_than_one_that_does_not_stretch() -> None:
    with pytest.raises(CdcsrError, match="cable_strain must be at least -0 1/N"):
        Parameters(cable_strain=-1e-6).plant(load_robot("paper"), 1)
    with pytest.raises(ValueError, match="at least the largest pull"):
        elastic(load_robot("paper"), 200.0)
