"""Momentum and energy are conserved, as far as they should be, and motion keeps the symmetries.

No external force acts on the robot: its linear momentum, its angular momentum about the centre of
mass, and the straight path of that centre are conserved, whatever the cables do.

The energy is that of motion, of hinge springs, and of servos as springs from sliders to set-points.
While the set-points are held, nothing adds energy: dampers take it out, ideal cables do no work,
and a slack cable that becomes taut is an inelastic impact. Without damping and impacts it is
conserved.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import at, commands_of, moving, running, straight
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array
from cdcsr.tasks.observation import DISTANCE, TARGET, TIP_POSITION
from cdcsr.tasks.symmetry import images
from tests.support.physics import described_bodies, energy, finer, momentum, with_parts

DURATION = 0.15
"""The time of a run, in [s]."""


def drifting(robot: Robot) -> tuple[Array, Array]:
    """Return position and velocity of a straight robot that moves and turns as one rigid body."""
    start = straight(robot)
    start.velocity[0, :6] = [0.05, -0.02, 0.03, 0.2, -0.3, 0.25]
    return start.position, start.velocity


def drift(coarse: Robot, engine: str, divide: int) -> Array:
    """Return the largest changes of both momenta and of the centre's path, relative to their size.

    Random commands act at full range, the same ones in time at every time step.
    """
    robot, largest = finer(coarse, divide), np.zeros(3)
    with running(robot, engine) as simulation:
        simulation.set_snapshot(at(robot, *drifting(robot)))
        linear, angular, center = momentum(simulation)
        for command in commands_of(coarse, round(DURATION / coarse.time_step)):
            simulation.step(command, divide)
            now = momentum(simulation)
            path = center + linear / robot.total_mass * simulation.state().time[:, None]
            found = [now[0] - linear, now[1] - angular, now[2] - path]
            largest = np.maximum(largest, np.linalg.norm(found, axis=2)[:, 0])
        size = [np.linalg.norm(linear), np.linalg.norm(angular), robot.arm_length]
    return largest / size


def test_momentum_drifts_only_by_the_integrators_error(robot: Robot, undamped_engine: str) -> None:
    """The integrators are of first order: the drift halves with the step (measured order 0.90 to
    1.00)."""
    drifts = [drift(robot, undamped_engine, divide) for divide in (1, 2, 4)]
    assert (drifts[0] < [2e-3, 1e-3, 2e-6]).all()
    orders = np.log2(np.array(drifts[:-1]) / drifts[1:])
    assert (orders > 0.85).all()
    assert (orders < 1.3).all()


def test_a_placed_copy_has_the_momentum_of_its_bodies(robot: Robot, engine: str) -> None:
    """Straight, turned, and in motion as one rigid body: sums over the description's bodies."""
    position, velocity = drifting(robot)
    position[0, :3], turn = [0.1, -0.2, 0.3], Rotation.from_rotvec([0.4, -0.5, 0.6])
    position[0, 3:7] = turn.as_quat(scalar_first=True)
    with running(robot, engine, 2) as simulation:
        simulation.place([1], position, velocity)
        linear, angular, center = (rows[1] for rows in momentum(simulation))
    _, mass, inertia, at_rest = zip(*described_bodies(robot), strict=True)
    mass, spin = np.array(mass)[:, None], velocity[0, 3:6]
    place = position[0, :3] + turn.apply(at_rest)
    speed = velocity[0, :3] + np.cross(spin, place - position[0, :3])
    middle = (mass * place).sum(0) / mass.sum()
    own = turn.apply(np.array(inertia).sum(0) * turn.inv().apply(spin))
    about_middle = own + (mass * np.cross(place - middle, speed)).sum(0)
    np.testing.assert_allclose(center, middle, atol=1e-12)
    np.testing.assert_allclose(linear, (mass * speed).sum(0), rtol=1e-10)
    np.testing.assert_allclose(angular, about_middle, rtol=1e-10)


def test_an_idle_robot_stays_where_it_is(robot: Robot, engine: str) -> None:
    with running(robot, engine) as simulation:
        simulation.step(np.zeros((1, robot.num_cables)), 100)
        state = simulation.state()
    np.testing.assert_allclose(
        state.tip_position, [[0, 0, robot.top + robot.arm_length]], atol=1e-9
    )
    np.testing.assert_allclose(state.base_position, 0, atol=1e-9)
    np.testing.assert_allclose(state.joint_angles, 0, atol=1e-9)
    np.testing.assert_allclose(state.time, 100 * robot.time_step, rtol=1e-12)


def largest_rise(coarse: Robot, engine: str, divide: int, seed: int) -> float:
    """Return how far the energy rises above its lowest value before, relative to the start, in
    0.3 s."""
    robot, command = finer(coarse, divide), commands_of(coarse, 1, seed=seed)[0]
    with running(robot, engine) as simulation:
        start = lowest = energy(robot, simulation, command)[0]
        now, rise = start, 0.0
        for _ in range(round(0.3 / coarse.time_step)):
            simulation.step(command, divide)
            now = energy(robot, simulation, command)[0]
            rise, lowest = max(rise, now - lowest), min(lowest, now)
        assert now < 0.999 * start
    return float(rise / start)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_under_held_commands_energy_only_falls(robot: Robot, engine: str, seed: int) -> None:
    """It never rises, neither at the shipped time step nor at a quarter of it."""
    assert max(largest_rise(robot, engine, divide, seed) for divide in (1, 4)) < 1e-12


def gain_and_loss(
    coarse: Robot, engine: str, divide: int, position: Array, velocity: Array, command: Array
) -> float:
    """Return the largest change of the energy, relative to the start, in 0.15 s without any
    damping."""
    undamped = with_parts(coarse, joint={"damping": 0.0}, servo={"damping": 0.0})
    robot, departure = finer(undamped, divide), 0.0
    with running(robot, engine) as simulation:
        simulation.set_snapshot(at(robot, position, velocity))
        start = energy(robot, simulation, command)[0]
        for _ in range(round(0.15 / coarse.time_step)):
            simulation.step(command, divide)
            departure = max(departure, abs(energy(robot, simulation, command)[0] - start))
    return departure / start


def test_without_damping_a_moving_robot_keeps_its_energy(
    robot: Robot, undamped_engine: str
) -> None:
    """Base, arm and sliders move and all cables are slack: these are free rigid bodies and springs.
    The error is of first order (measured 1.0)."""
    start, cables = moving(robot, 1, bend=0.05), robot.num_cables
    start.position[0, 7 : 7 + cables] = 0.05
    start.velocity[0] *= 0.3
    command = np.full((1, cables), 0.05)
    errors = [
        gain_and_loss(robot, undamped_engine, divide, start.position, start.velocity, command)
        for divide in (1, 4, 8)
    ]
    assert errors[0] < 3e-4
    assert errors[2] < 3e-5
    assert np.log2(errors[1] / errors[2]) > 0.85


def test_without_damping_taut_cables_keep_the_energy(robot: Robot, stiff_engine: str) -> None:
    """Springs of servos and hinges and the moving arm exchange energy through taut cables, which
    take none.

    The error is of first order (measured 0.98 to 0.99).
    """
    start, command = straight(robot), np.zeros((1, robot.num_cables))
    command[0, [0, -1]] = -0.3, -0.2
    errors = [
        gain_and_loss(robot, stiff_engine, divide, start.position, start.velocity, command)
        for divide in (1, 2)
    ]
    assert errors[0] < 2e-4
    assert np.log2(errors[0] / errors[1]) > 0.85


def test_mirrored_commands_give_the_mirrored_motion(engine: str, robot: Robot) -> None:
    """The image of each command leads to the image of each observation: tip, base, its turning,
    sliders, and speeds."""
    known = images(robot)
    env = TaskVectorEnv(len(known), robot, engine, autoreset_mode="Disabled")
    rng = np.random.default_rng(0)
    eta = np.array([servo.eta for servo in robot.servos])
    command, moved = -eta, np.zeros(3)
    start, _ = env.reset(seed=0)
    for action in range(120):
        if action % 10 == 0:
            command = -eta * rng.random(robot.num_cables) * (rng.random(robot.num_cables) > 0.5)
        observation, *_ = env.step(np.array([image.command(command) for image in known]))
        moved = np.maximum(moved, np.abs(observation[0] - start[0])[TIP_POSITION])
        for image, seen in zip(known, observation, strict=True):
            expected = image.observation(observation[0])
            # Each copy has a target of its own.
            expected[TARGET], expected[DISTANCE] = seen[TARGET], seen[DISTANCE]
            np.testing.assert_allclose(seen, expected, atol=1e-7, err_msg=image.name)
    env.close()
    assert moved[:2].min() > 0.005  # it was bent both ways
