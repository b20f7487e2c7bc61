"""The PyBullet engine against PyBullet's own functions and itself. The physics is tested in every engine."""

from __future__ import annotations

import dataclasses
import gc
import itertools
import json
import os
import signal
import xml.etree.ElementTree as ET

import numpy as np
import pybullet
import pytest

from backends.pybullet.benchmarks import step_cost
from backends.pybullet.cables import joint_forces, rig
from backends.pybullet.client import connect, load_robot_body
from backends.pybullet.dynamics import (
    bias_force,
    chain,
    forward_kinematics,
    mass_matrix,
    tip_states,
)
from backends.pybullet.equation import Equation
from backends.pybullet.lcp import solve_complementarity
from backends.pybullet.simulation import PybulletSimulation
from backends.pybullet.urdf import cable_file, joint_names, urdf
from backends.pybullet.workers import Pool
from backends.pybullet.world import World
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Snapshot
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed


def random_states(
    robot: Robot, num: int, bend: float, speed: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of tilted, moving, bent robots."""
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=(num, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    travel = random.uniform(-0.01, 0.01, (num, robot.num_cables))
    hinges = random.uniform(-bend, bend, (num, robot.num_hinges))
    place = random.normal(size=(num, 3))
    velocity = speed * random.normal(size=(num, robot.num_coordinates))
    return np.concatenate([place, quaternion, travel, hinges], axis=1), velocity


def random_commands(robot: Robot, steps: int, num: int = 1, seed: int = 0) -> np.ndarray:
    """Set-points that jump every ten steps, shape (steps, num, C)."""
    draws = np.random.default_rng(seed).uniform(
        -robot.servos[0].eta, 0, (steps // 10 + 1, num, robot.num_cables)
    )
    return np.repeat(draws, 10, axis=0)[:steps]


# --- the model ---------------------------------------------------------------------------------------------------


def test_urdf_holds_the_whole_robot(robot: Robot) -> None:
    text = urdf(robot)
    assert max(len(line) for line in text.splitlines()) < 300
    root = ET.fromstring(text)
    assert [joint.get("name") for joint in root.findall("joint")] == joint_names(robot)
    assert sum(float(mass.attrib["value"]) for mass in root.iter("mass")) == pytest.approx(
        robot.total_mass, rel=1e-14
    )


def test_urdf_draws_meshes_where_there_are_some(paper: Robot) -> None:
    root = ET.fromstring(urdf(paper, {"base": "base.obj"}))
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == ["base.obj"]


def test_guides_of_the_cable_file_are_as_far_apart_as_the_rest_length(robot: Robot) -> None:
    file = json.loads(json.dumps(cable_file(robot)))
    heights = {"base": 0.0} | {
        f"link_{j}": robot.top + sum(link.length for link, _ in robot.links[:j])
        for j in range(robot.num_links)
    }
    for cable, servo in zip(file["cables"], robot.servos, strict=True):
        points = np.array(
            [np.add(guide["xyz"], (0, 0, heights[guide["link"]])) for guide in cable["guides"]]
        )
        along = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert along + servo.offset == pytest.approx(cable["rest_length"], rel=1e-12)


def test_pybullet_has_the_masses_and_inertias_that_were_written(robot: Robot) -> None:
    client = connect(robot)
    body = load_robot_body(robot, client)
    found = [
        pybullet.getDynamicsInfo(body, i, physicsClientId=client)
        for i in range(-1, len(joint_names(robot)))
    ]
    pybullet.disconnect(physicsClientId=client)
    expected = [(robot.base.mass, robot.base.inertia)]
    expected += [(servo.mass, (0.4 * servo.mass * servo.radius**2,) * 3) for servo in robot.servos]
    for link, _ in robot.links:
        expected += [(0.0, (0.0, 0.0, 0.0)), (link.mass, link.inertia)]
    for info, (mass, inertia) in zip(found, expected, strict=True):
        assert info[0] == pytest.approx(mass, rel=1e-14)
        assert info[2] == pytest.approx(inertia, rel=1e-14)


# --- the compiled dynamics ---------------------------------------------------------------------------------------


def test_compiled_dynamics_is_pybullets(robot: Robot) -> None:
    position, velocity = random_states(robot, 5, bend=1.0, speed=2.0)
    equation = Equation(robot)
    theirs, numbers = equation(position, velocity), chain(robot)
    equation.close()
    for n in range(len(position)):
        frames = forward_kinematics(numbers, position[n])
        mass, expected = mass_matrix(numbers, frames), theirs.mass_matrix[n]
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.max(np.abs(mass - expected) / size) < 1e-10
        bias, expected = bias_force(numbers, frames, velocity[n]), theirs.bias_force[n]
        np.testing.assert_allclose(bias, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    place, speed = tip_states(numbers, position, velocity)
    np.testing.assert_allclose(
        speed, np.einsum("nij,nj->ni", theirs.tip_jacobian, velocity), atol=1e-12
    )
    assert place.shape == (5, 3)


# --- cables and limits -------------------------------------------------------------------------------------------


def test_complementarity_against_trying_every_basis() -> None:
    random = np.random.default_rng(1)
    for trial in range(200):
        order = 5
        factor = random.normal(size=(order, order))
        matrix, vector = factor @ factor.T + 0.01 * np.eye(order), random.normal(size=order)
        vector[trial % order] *= trial % 3  # some are degenerate
        solutions = []
        for members in itertools.product([False, True], repeat=order):
            basis, x = np.array(members), np.zeros(order)
            x[basis] = np.linalg.solve(matrix[np.ix_(basis, basis)], -vector[basis])
            if (x >= 0).all() and (matrix @ x + vector >= -1e-12).all():
                solutions.append(x)
        for guess in (np.zeros(order), np.ones(order), random.uniform(-1, 1, order)):
            found = guess.copy()
            solve_complementarity(matrix, vector, order, found)
            np.testing.assert_allclose(found, solutions[0], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("limit", [1.5, 0.08])
def test_forces_solve_the_step_they_are_meant_for(robot: Robot, limit: float) -> None:
    """The force given to PyBullet's equation yields (M + hC) a = f - bias - L^T t with t complementary to slack."""
    segments = [
        s | {"joint": s["joint"] | {"limit": limit}} for s in robot.model_dump()["segments"]
    ]
    robot = changed(robot, segments=segments)
    step, recovery, cables = robot.time_step, robot.constraint.recovery_time, robot.num_cables
    position, velocity = random_states(robot, 20, bend=0.1, speed=0.5)
    command = np.random.default_rng(2).uniform(-5, 0, (len(position), cables))
    tension, force = (
        np.zeros((len(position), cables)),
        np.zeros((len(position), robot.num_coordinates - 6)),
    )
    plant = Parameters().plant(robot, len(position))
    joint_forces(chain(robot), rig(robot), plant, position, velocity, command, tension, force)
    equation, route = Equation(robot), routing(robot)
    theirs = equation(position, velocity)
    equation.close()
    gap = route.rest_length - cable_lengths(
        route, position[:, 7 : 7 + cables], position[:, 7 + cables :]
    )
    damping = np.concatenate([np.zeros(6), rig(robot).damping])
    pulled = pushed = 0
    for n in range(len(position)):
        applied = np.concatenate([np.zeros(6), force[n]])
        acceleration = np.linalg.solve(theirs.mass_matrix[n], applied - theirs.bias_force[n])
        after = velocity[n] + step * acceleration
        slack = (
            np.where(gap[n] >= 0, gap[n] / step, gap[n] / recovery)
            - theirs.cable_jacobian[n] @ after
        )
        assert slack.min() > -1e-9
        assert tension[n].min() >= 0
        assert np.abs(slack * tension[n]).max() < 1e-7
        servo = np.zeros_like(applied)
        servo[6 : 6 + cables] = [s.gain for s in robot.servos] * (
            command[n] - position[n, 7 : 7 + cables]
        )
        net = (
            theirs.passive_force[n]
            + servo
            - theirs.bias_force[n]
            - theirs.cable_jacobian[n].T @ tension[n]
        )
        rest = (
            theirs.mass_matrix[n] + step * np.diag(damping)
        ) @ acceleration - net  # what the limits do
        np.testing.assert_allclose(rest[: 6 + cables], 0, atol=1e-9)
        for angle, rate, push in zip(
            position[n, 7 + cables :], after[6 + cables :], rest[6 + cables :], strict=True
        ):
            side = (
                -np.sign(push) if abs(push) > 1e-9 else np.sign(rate)
            )  # the limit that pushes, or may be met
            room = limit - side * angle
            left = (room / step if room >= 0 else room / recovery) - side * rate
            assert left > -1e-9
            assert abs(push) < 1e-9 or left < 1e-9
            pushed += abs(push) > 1e-9
        pulled += int((tension[n] > 0).sum())
    assert pulled > 0
    assert (pushed > 0) == (limit < 0.1)


def test_pybullet_steps_as_its_equation_says(robot: Robot) -> None:
    """Nothing of PyBullet's own acts: no damping, motor, limit or clamp, in any coordinate."""
    world = World(robot, 4)
    position, velocity = random_states(robot, 4, bend=0.3, speed=2.0)
    command = np.random.default_rng(3).uniform(-5, 0, (4, robot.num_cables))
    world.place(np.zeros(4), position, velocity, np.zeros((4, robot.num_cables)))
    world.step(command, 1)
    equation = Equation(robot)
    theirs = equation(position, velocity)
    equation.close()
    force = np.concatenate([np.zeros((4, 6)), world._force], axis=1)
    expected = np.linalg.solve(theirs.mass_matrix, (force - theirs.bias_force)[..., None])[..., 0]
    found = (world.velocity - velocity) / robot.time_step
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(
        world.position[:, 7:], position[:, 7:] + robot.time_step * world.velocity[:, 6:]
    )
    world.close()


def test_hinge_limit_stops_the_arm(paper: Robot) -> None:
    segments = [s | {"joint": s["joint"] | {"limit": 0.05}} for s in paper.model_dump()["segments"]]
    reach = []
    for robot in (paper, changed(paper, segments=segments)):
        simulation = PybulletSimulation(robot)
        command = np.zeros((1, robot.num_cables))
        command[0, 0] = -5
        simulation.step(command, 80)
        reach.append(np.abs(simulation.state().joint_angles).max())
        simulation.close()
    assert reach[0] > 0.1
    assert reach[1] == pytest.approx(0.05, abs=1e-9)


def test_joint_speed_is_not_clamped(paper: Robot) -> None:
    simulation = PybulletSimulation(paper)
    snapshot = simulation.get_snapshot()
    snapshot.velocity[0, -1] = 150.0
    simulation.set_snapshot(snapshot)
    simulation.step(np.zeros((1, paper.num_cables)))
    rate = simulation.state().joint_rates[0, -1]
    simulation.close()
    assert rate > 101


# --- copies, snapshots, workers ----------------------------------------------------------------------------------


def with_velocity(snapshot: Snapshot, copy: int, speed: float) -> Snapshot:
    velocity = snapshot.velocity.copy()
    velocity[copy, -1] = speed
    return dataclasses.replace(snapshot, velocity=velocity)


@pytest.mark.parametrize("workers", [0, 2])
def test_divergence_names_copy_and_time_and_spares_the_others(paper: Robot, workers: int) -> None:
    commands = random_commands(paper, 10, num=4)
    simulation, other = (
        PybulletSimulation(paper, 4, workers=workers),
        PybulletSimulation(paper, 4, workers=0),
    )
    for command in commands:
        simulation.step(command)
        other.step(command)
    for bad in (1e6, np.nan):
        simulation.set_snapshot(with_velocity(other.get_snapshot(), 3, bad))
        with pytest.raises(Diverged, match=r"pybullet: copy 3 diverged at t = 0\.0275 s") as caught:
            simulation.step(commands[0], 5)
        assert (caught.value.copy, caught.value.time) == (3, pytest.approx(0.0275))
    other.step(commands[0], 5)
    np.testing.assert_allclose(
        simulation.state().tip_position[:3], other.state().tip_position[:3], atol=1e-12
    )
    np.testing.assert_allclose(
        simulation.state().tip_position[3], [0, 0, paper.top + paper.arm_length], atol=1e-12
    )
    simulation.step(commands[0])  # and it goes on
    simulation.close()
    other.close()


def test_an_impossible_time_step_diverges(paper: Robot) -> None:
    simulation = PybulletSimulation(
        changed(paper, time_step=0.5, constraint={"recovery_time": 1.0})
    )
    with pytest.raises(Diverged, match="smaller time_step"):
        simulation.step(-5.0 * np.arange(float(paper.num_cables))[None], 50)
    simulation.close()


def test_workers_give_the_same_numbers(paper: Robot) -> None:
    commands = random_commands(paper, 20, num=5)
    here, there = PybulletSimulation(paper, 5, workers=0), PybulletSimulation(paper, 5, workers=2)
    for command in commands:
        here.step(command, 2)
        there.step(command, 2)
    here.reset([0, 4])
    there.reset([0, 4])
    for field in dataclasses.fields(here.state()):
        np.testing.assert_array_equal(
            getattr(here.state(), field.name), getattr(there.state(), field.name)
        )
    np.testing.assert_array_equal(here.dynamics([1]).mass_matrix, there.dynamics([1]).mass_matrix)
    here.close()
    there.close()


def test_workers_end_with_their_simulation(paper: Robot) -> None:
    simulation = PybulletSimulation(paper, 2, workers=2)
    assert isinstance(simulation._world, Pool)
    processes = simulation._world._workers
    del simulation
    gc.collect()
    assert all(process.poll() is not None for process in processes)


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_lost_worker_is_an_error_and_no_hang(paper: Robot) -> None:
    simulation = PybulletSimulation(paper, 4, workers=2)
    assert isinstance(simulation._world, Pool)
    os.kill(simulation._world._workers[1].pid, signal.SIGKILL)
    command = np.zeros((4, paper.num_cables))
    with pytest.raises(CdcsrError, match="worker process of copies 2 to 3 ended unexpectedly"):
        simulation.step(command)
    with pytest.raises(CdcsrError, match="make a new one"):
        simulation.step(command)
    simulation.close()


def test_mistakes_are_told(paper: Robot) -> None:
    with pytest.raises(CdcsrError, match="0 to 2 worker processes, not 3"):
        PybulletSimulation(paper, 2, workers=3)
    simulation = PybulletSimulation(paper, 2)
    with pytest.raises(CdcsrError, match=r"\(2, 8\), not \(8,\)"):
        simulation.step(np.zeros(8))
    simulation.close()


# --- pictures and speed ------------------------------------------------------------------------------------------


def test_pictures_show_the_copy_and_its_targets(paper: Robot) -> None:
    simulation = PybulletSimulation(paper, 2)
    command = np.zeros((2, paper.num_cables))
    command[1, 4] = -5
    simulation.step(command, 100)
    straight, bent = simulation.render(0), simulation.render(1)
    marked = simulation._renderer.draw(
        simulation.get_snapshot().position[0], targets=[[0.2, 0.1, 2.45]]
    )
    simulation.close()
    assert straight.shape == (640, 480, 3)
    assert straight.dtype == np.uint8
    assert (straight != bent).any(axis=2).sum() > 500
    rows, columns = np.nonzero((straight != marked).any(axis=2))
    assert 10 < len(rows) < 200
    assert rows.mean() < 200  # high up
    assert columns.mean() > 240  # and to the right of the arm, as seen by this camera


@pytest.mark.slow
def test_cables_cost_little(paper: Robot) -> None:
    step, bare = step_cost(paper)
    assert step < 6 * bare
