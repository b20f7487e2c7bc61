"""The largest stable time step, against the fastest mode of the assembled robot."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.robot.description import load_robot, shipped_robots
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.engines import make_simulation


@pytest.mark.parametrize("name", shipped_robots())
def test_the_bound_is_safe_and_near_the_fastest_mode(name: str) -> None:
    """The modes are the eigenvalues of M^-1 K, straight and with every hinge at a limit or zero."""
    robot, random, num = load_robot(name), np.random.default_rng(0), 64
    simulation = make_simulation(robot, "mujoco", num)
    first = 6 + robot.num_cables
    limit = np.repeat([joint.limit for _, joint in robot.links], 2)
    position, velocity = simulation.get_snapshot().position, np.zeros((num, first + limit.size))
    position[1:, first + 1 :] = limit * random.choice([-1, 0, 1], (num - 1, limit.size))
    simulation.place(None, position, velocity)
    mass = simulation.dynamics().mass_matrix
    simulation.close()
    stiffness = np.zeros(velocity.shape[1])
    stiffness[6:first] = [servo.gain for servo in robot.servos]
    stiffness[first:] = np.repeat([joint.stiffness for _, joint in robot.links], 2)
    fastest = np.linalg.eigvals(np.linalg.solve(mass, np.diag(stiffness))).real.max()
    largest = 2 / np.sqrt(fastest)
    assert stable_step(robot) <= largest <= 4 * stable_step(robot)
