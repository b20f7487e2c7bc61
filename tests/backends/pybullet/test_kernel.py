"""The compiled kernel compared with PyBullet's own functions and with PyBullet's step."""

from __future__ import annotations

import numpy as np
import pytest

from backends.pybullet.cables import joint_forces, rig
from backends.pybullet.dynamics import (
    bias_force,
    chain,
    forward_kinematics,
    mass_matrix,
    tip_states,
)
from backends.pybullet.equation import Equation
from backends.pybullet.world import World
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed


def random_states(
    robot: Robot, num: int, bend: float, speed: float, seed: int = 0
) -> tuple[Array, Array]:
    """Return positions and velocities of tilted, moving, bent robots."""
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=(num, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    travel = random.uniform(-0.01, 0.01, (num, robot.num_cables))
    hinges = random.uniform(-bend, bend, (num, robot.num_hinges))
    place = random.normal(size=(num, 3))
    velocity = speed * random.normal(size=(num, robot.num_coordinates))
    return np.concatenate([place, quaternion, travel, hinges], axis=1), velocity


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


@pytest.mark.parametrize("limit", [1.5, 0.08])
def test_forces_solve_the_step_they_are_meant_for(robot: Robot, limit: float) -> None:
    """In PyBullet's equation the forces give (M + hC) a = f - bias - L^T t, and t is complementary
    to the slack at the end of the step."""
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
    gain = np.array([servo.gain for servo in robot.servos])
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
        servo[6 : 6 + cables] = gain * (command[n] - position[n, 7 : 7 + cables])
        net = theirs.passive_force[n] + servo - theirs.bias_force[n]
        net -= theirs.cable_jacobian[n].T @ tension[n]
        inertia = theirs.mass_matrix[n] + step * np.diag(damping)
        rest = inertia @ acceleration - net  # the forces of the limits
        np.testing.assert_allclose(rest[: 6 + cables], 0, atol=1e-9)
        for angle, rate, push in zip(
            position[n, 7 + cables :], after[6 + cables :], rest[6 + cables :], strict=True
        ):
            # The limit that pushes, or the one that the hinge moves towards.
            side = -np.sign(push) if abs(push) > 1e-9 else np.sign(rate)
            room = limit - side * angle
            left = (room / step if room >= 0 else room / recovery) - side * rate
            assert left > -1e-9
            assert abs(push) < 1e-9 or left < 1e-9
            pushed += abs(push) > 1e-9
        pulled += int((tension[n] > 0).sum())
    assert pulled > 0
    assert (pushed > 0) == (limit < 0.1)


def test_pybullet_steps_as_its_equation_says(robot: Robot) -> None:
    """PyBullet adds no damping, motor, limit or clamp in any coordinate."""
    world = World(robot, 4)
    position, velocity = random_states(robot, 4, bend=0.3, speed=2.0)
    command = np.random.default_rng(3).uniform(-5, 0, (4, robot.num_cables))
    world.place(np.arange(4), np.zeros(4), position, velocity, np.zeros((4, robot.num_cables)))
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
