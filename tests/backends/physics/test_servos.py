"""Servos of every kind hold what they are commanded, and no more than their force limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from backends.contract_suite.states import assert_same, commands_of, running, straight
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.declarations import check_abilities
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from controllers.controller import Conditions, Target
from controllers.jacobian import JacobianController
from tests.backends.physics.test_statics import settling, taken_in
from tests.support.physics import momentum, with_parts

TENSION = {"kind": "tension", "gain": None, "eta": None, "largest_tension": 250.0}


def arm(**servo: object) -> Robot:
    """Return a light, damped arm of one segment with four servos."""
    return with_parts(settling(load_robot("planar-single")), servo=servo)


def test_an_antagonistic_pair_holds_the_arm_where_no_virtual_work_is_done(
    undamped_engine: str,
) -> None:
    """Two cables pull with constant tensions T: where the arm rests, 1/2 k q^2 + T (what it takes
    in) is least."""
    robot, pulls = arm(**TENSION), np.array([30.0, 4.0, 12.0, 0.0])
    stiffness = np.array([hinge.stiffness for hinge in robot.hinges])

    def potential(hinges: Array) -> float:
        return float(0.5 * stiffness @ hinges**2 + pulls @ taken_in(robot, hinges))

    start = np.zeros(robot.num_hinges)
    expected = minimize(potential, start, method="BFGS", options={"gtol": 1e-9}).x
    assert np.abs(expected).max() > 0.02
    with running(robot, undamped_engine) as simulation:
        simulation.step(pulls[None], 4000)
        state = simulation.state()
    np.testing.assert_allclose(state.joint_angles[0], expected, atol=5e-4)
    np.testing.assert_allclose(state.cable_tension[0, :3], pulls[:3], atol=2e-2)


def test_a_displacement_servo_drives_its_slider_to_the_commanded_travel(
    undamped_engine: str,
) -> None:
    """It gives way by T / gain, with a gain at which an explicit spring would explode."""
    gain = 1e5
    robot, command = arm(kind="displacement", gain=gain, eta=0.05), np.array([[-0.01, 0, 0, 0.0]])
    assert robot.time_step**2 * gain / robot.servos[0].mass > 3
    with running(robot, undamped_engine) as simulation:
        simulation.step(command, 4000)
        state = simulation.state()
    assert state.cable_tension[0, 0] > 1
    expected = command[0] + state.cable_tension[0] / gain
    np.testing.assert_allclose(state.cable_travel[0], expected, atol=1e-6)


def test_a_servo_pulls_no_harder_than_its_force_limit(undamped_engine: str) -> None:
    robot = arm(force_limit=12.0)
    with running(robot, undamped_engine) as simulation:
        simulation.step(np.array([[-5.0, 0, 0, 0]]), 4000)
        tension = simulation.state().cable_tension[0, 0]
    assert tension == pytest.approx(12, abs=1e-2)


def test_pretension_pulls_all_cables_of_the_straight_arm(undamped_engine: str) -> None:
    """Four equal cables hold each other: nothing moves, and each has its pretension."""
    robot = arm(pretension=8.0)
    with running(robot, undamped_engine) as simulation:
        simulation.step(np.zeros((1, 4)), 500)
        state = simulation.state()
    np.testing.assert_allclose(state.joint_angles, 0, atol=1e-6)
    soft = "soft_cables" in simulation.capabilities  # stretch takes some of it off the spring
    np.testing.assert_allclose(state.cable_tension, 8.0, rtol=0.05 if soft else 1e-3)


def test_a_servo_that_pulls_half_as_hard_again_is_one_that_is_told_so(engine: str) -> None:
    """A servo for tensions has no spring, so its gain only scales the command."""
    robot, command = arm(**TENSION), np.array([[9.0, 0.0, 3.0, 6.0]])
    ends = []
    for gain in (1.0, 1.5):
        with running(robot, engine) as simulation:
            if gain != 1:
                simulation.set_parameters(None, Parameters(servo_gain=gain))
            simulation.step(command * 1.5 / gain, 40)
            ends.append(simulation.state())
    assert_same(*ends, atol=1e-9)
    assert np.abs(ends[0].cable_travel).max() > 1e-3


def test_the_demonstrator_asks_any_servo_for_the_same_tensions() -> None:
    """The set-point of a soft servo is travel - T / gain, less the pretension; the command of a
    tension servo is T."""
    soft, tension = (
        load_robot("planar-single"),
        with_parts(load_robot("planar-single"), servo={**TENSION, "pretension": 2.0}),
    )
    found = []
    for robot in (soft, tension):
        with running(robot, "mujoco") as simulation:
            controller = JacobianController(robot)
            controller.begin(Conditions(robot, 0.0025, False, dynamics=simulation.dynamics))
            target = Target(np.array([[0.001, 0.0003, 1.5]]), np.zeros((1, 3)))
            found.append(controller.act(simulation.state(), target, np.zeros(1))[0])
    pulls = -found[0] * soft.servos[0].gain
    assert pulls.max() > 10
    np.testing.assert_allclose(found[1], np.maximum(pulls - 2.0, 0), rtol=5e-3)


def test_what_cannot_be_is_refused_in_one_line() -> None:
    driven = arm(kind="displacement", gain=1e5, eta=0.05)
    with pytest.raises(CdcsrError, match="write pybullet-stock:servo=force"):
        make_simulation(driven, "pybullet-stock")
    with pytest.raises(CdcsrError, match="third has set-point servos only"):
        check_abilities("third", frozenset(), driven, Parameters().plant(driven, 1))
    with pytest.raises(ValueError, match="a tension servo needs largest_tension, and has no gain"):
        arm(kind="tension")
    with pytest.raises(ValueError, match="only a tension servo has largest_tension"):
        arm(largest_tension=9.0)
    with pytest.raises(ValueError, match="must be above pretension"):
        arm(pretension=5.0, force_limit=5.0)


def test_commands_go_from_zero_to_full_pull_whatever_the_kind() -> None:
    """A robot may mix kinds; the action -1 of a policy is the full pull of each, 1 is none."""
    data = load_robot("paper").model_dump()
    data["segments"][1]["servo"] |= TENSION
    robot = Robot.model_validate(data)
    first = len(data["segments"][0]["cables"]["angles_deg"])
    full = np.where(np.arange(robot.num_cables) < first, -data["segments"][0]["servo"]["eta"], 250)
    lowest, highest = robot.command_range
    np.testing.assert_array_equal(lowest, np.minimum(full, 0))
    np.testing.assert_array_equal(highest, np.maximum(full, 0))
    assert parse_robot(robot.to_toml()) == robot


def test_tensions_inside_the_robot_do_not_move_its_centre_of_mass(undamped_engine: str) -> None:
    """Both momenta of the free robot stay small beside what one cable pulls in that time."""
    robot = with_parts(load_robot("paper"), servo=TENSION)
    with running(robot, undamped_engine) as simulation:
        for command in commands_of(robot, 100):
            simulation.step(command / 5)
        state = simulation.state()
        linear, angular, _ = momentum(simulation)
    assert np.abs(state.joint_rates).max() > 0.1
    impulse = 50 / 2 * 100 * robot.time_step  # of one cable, with its mean tension
    assert np.abs(linear).max() < 1e-3 * impulse
    assert np.abs(angular).max() < 1e-3 * impulse * robot.arm_length


def test_bullets_motor_pulls_and_pushes_with_all_its_force_while_it_is_far_off() -> None:
    """A step h of a slider m with a slack cable and a damper c: m dv = h g (command - travel)."""
    robot, step = load_robot("paper"), load_robot("paper").time_step
    travel, command = np.linspace(0.02, 0.09, 8), np.linspace(-0.2, 0.3, 8)
    start = straight(robot)
    start.position[0, 7:15] = travel
    with running(robot, "pybullet:servo=motor") as simulation:
        simulation.set_snapshot(start)
        simulation.step(command[None])
        found = simulation.get_snapshot().velocity[0, 6:14]
    servo = robot.servos[0]
    expected = step * servo.gain * (command - travel) / servo.mass
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
    assert np.ptp(np.sign(expected)) == 2
