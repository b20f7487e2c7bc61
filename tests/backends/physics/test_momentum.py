"""No external force acts on the robot: its linear momentum, its angular momentum about the centre
of mass, and the straight path of that centre are conserved, whatever the cables do."""

from __future__ import annotations

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array
from tests.support.physics import at, commands_of, finer, momentum, running, straight

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


def test_momentum_drifts_only_by_the_integrators_error(robot: Robot, engine: str) -> None:
    """The integrators are of first order: the drift halves with the step (measured order 0.90 to
    1.00)."""
    drifts = [drift(robot, engine, divide) for divide in (1, 2, 4)]
    assert (drifts[0] < [2e-3, 1e-3, 2e-6]).all()
    orders = np.log2(np.array(drifts[:-1]) / drifts[1:])
    assert (orders > 0.85).all()
    assert (orders < 1.3).all()


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
