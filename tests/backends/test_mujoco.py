"""MuJoCo stepping many copies: conservation laws, cables, snapshots, divergence."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from backends.mujoco.simulation import MujocoSimulation
from cdcsr.cables import cable_lengths, routing
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot import Robot, load_robot, shipped_robots
from cdcsr.simulation import Array


@pytest.fixture(params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def paper() -> Robot:
    return load_robot("paper")


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its warnings to a file in the working directory."""
    monkeypatch.chdir(tmp_path)


def commands_of(robot: Robot, steps: int, num: int = 1, seed: int = 0, hold: int = 20) -> Array:
    """Random commands, shape (steps, num, C), each held for some steps as only then do they move the arm."""
    eta = np.array([servo.eta for servo in robot.servos])
    draws = np.random.default_rng(seed).uniform(-1, 0, (-(-steps // hold), num, robot.num_cables)) * eta
    return np.repeat(draws, hold, axis=0)[:steps]


def same_state(first: MujocoSimulation, second: MujocoSimulation) -> None:
    """To the bit, tensions included."""
    for field in dataclasses.fields(first.state()):
        np.testing.assert_array_equal(getattr(first.state(), field.name), getattr(second.state(), field.name))


# --- motion ------------------------------------------------------------------------------------------------------


def momentum(simulation: MujocoSimulation) -> tuple[float, float]:
    """Magnitudes of linear momentum in [kg m/s] and of angular momentum about the centre of mass in [kg m²/s]."""
    equation = simulation.dynamics()
    mass, velocity = equation.mass_matrix[0], equation.velocity[0]
    linear, about_base = mass[:3] @ velocity, mass[3:6] @ velocity
    # Angular momentum of a unit translation is (first moment) x (direction).
    center = np.array([mass[5, 1], mass[3, 2], mass[4, 0]]) / mass[0, 0]
    return float(np.linalg.norm(linear)), float(np.linalg.norm(about_base - np.cross(center, linear)))


def test_momentum_is_conserved_in_the_limit_of_small_steps(paper: Robot) -> None:
    """A robot that started at rest has none; what the integrator makes of it shrinks with the step."""
    drifts = []
    for divide in (1, 2, 4):
        robot = Robot.model_validate(paper.model_dump() | {"time_step": paper.time_step / divide})
        simulation = MujocoSimulation(robot)
        largest = np.zeros(2)
        for command in commands_of(robot, 200):
            simulation.step(command, divide)
            largest = np.maximum(largest, momentum(simulation))
        drifts.append(largest)
    assert (drifts[0] < [0.1, 0.15]).all()  # of 516 kg
    assert (drifts[1] < 0.6 * drifts[0]).all()
    assert (drifts[2] < 0.6 * drifts[1]).all()


def test_cables_pull_and_hold_their_length(robot: Robot) -> None:
    """Each cable pulled in full for 2 s, one copy a cable.

    MuJoCo sees a limit only once it is exceeded. So a cable that is slack by a rounding error lets go for a step,
    in which its slider flies free. That bounds how much too long any cable ever is; most of the time a pulled
    one keeps its length to 0.05 mm.
    """
    cables, steps = robot.num_cables, round(2 / robot.time_step)
    simulation, route = MujocoSimulation(robot, cables), routing(robot)
    eta, gain, mass, damping = np.array([(s.eta, s.gain, s.mass, s.damping) for s in robot.servos]).T
    command = -np.diag(eta)
    excess, tension, pull = [], [], []
    state = simulation.state()
    for _ in range(steps):
        simulation.step(command)
        state = simulation.state()
        assert state.cable_tension.min() >= 0
        excess.append(cable_lengths(route, state.cable_travel, state.joint_angles) - route.rest_length)
        tension.append(np.diagonal(state.cable_tension))
        pull.append(gain * np.diagonal(state.cable_travel - command))
    flight = gain * eta / mass * robot.time_step**2
    assert (np.array(excess) < flight).all()
    pulled = np.diagonal(excess, axis1=1, axis2=2)
    assert np.abs(np.median(pulled, axis=0)).max() <= 0.05e-3
    # A slider gains next to no momentum, so on average the cable bears the servo's pull less the friction.
    friction = damping * -np.diagonal(state.cable_travel) / (steps * robot.time_step)
    np.testing.assert_allclose(np.mean(tension, axis=0), np.mean(pull, axis=0) - friction, rtol=2e-3)


def test_an_idle_robot_stays_where_it_is(robot: Robot) -> None:
    simulation = MujocoSimulation(robot)
    simulation.step(np.zeros((1, robot.num_cables)), 100)
    state = simulation.state()
    np.testing.assert_allclose(state.tip_position, [[0, 0, robot.top + robot.arm_length]], atol=1e-9)
    np.testing.assert_allclose(state.base_position, 0, atol=1e-9)
    assert state.time[0] == pytest.approx(100 * robot.time_step)


# --- copies and snapshots ----------------------------------------------------------------------------------------


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


def test_substeps_are_steps_under_one_command(paper: Robot) -> None:
    command = commands_of(paper, 1)[0]
    at_once, one_by_one = MujocoSimulation(paper), MujocoSimulation(paper)
    at_once.step(command, 7)
    for _ in range(7):
        one_by_one.step(command)
    same_state(at_once, one_by_one)


def test_a_snapshot_continues_to_the_bit(paper: Robot) -> None:
    commands = commands_of(paper, 80, num=3)
    first, second = MujocoSimulation(paper, 3), MujocoSimulation(paper, 3)
    for command in commands[:40]:
        first.step(command)
    snapshot = first.get_snapshot()
    assert first.state().cable_tension.max() > 1
    second.step(commands[7])  # what it did before does not matter
    second.set_snapshot(snapshot)
    same_state(first, second)
    for command in commands[40:]:
        first.step(command)
        second.step(command)
    same_state(first, second)
    first.set_snapshot(snapshot)
    for command in commands[40:]:
        first.step(command)
    same_state(first, second)


def test_a_snapshot_of_something_else_is_an_error(paper: Robot) -> None:
    simulation = MujocoSimulation(paper, 2)
    with pytest.raises(CdcsrError, match="holds 3 copies; this simulation has 2"):
        simulation.set_snapshot(MujocoSimulation(paper, 3).get_snapshot())
    with pytest.raises(CdcsrError, match="is of robot"):
        simulation.set_snapshot(MujocoSimulation(load_robot("planar-single"), 2).get_snapshot())


def test_a_reset_copy_is_like_a_fresh_one_and_the_others_are_untouched(paper: Robot) -> None:
    commands = commands_of(paper, 60, num=4)
    simulation, undisturbed, fresh = (MujocoSimulation(paper, 4) for _ in range(3))
    for command in commands[:30]:
        simulation.step(command)
        undisturbed.step(command)
    simulation.reset([1, 3])
    for step, command in enumerate(commands[30:]):
        for field in dataclasses.fields(simulation.state()):
            value, others, start = (getattr(s.state(), field.name) for s in (simulation, undisturbed, fresh))
            np.testing.assert_array_equal(value[[0, 2]], others[[0, 2]], f"{field.name}, {step} steps later")
            np.testing.assert_array_equal(value[[1, 3]], start[[1, 3]], f"{field.name}, {step} steps later")
        for each in (simulation, undisturbed, fresh):
            each.step(command)
    simulation.reset()
    same_state(simulation, MujocoSimulation(paper, 4))


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
