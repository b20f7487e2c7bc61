"""Cables pull and never push, only when taut, hardly stretch, and pass all work on from the sliders
to the joints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array, Simulation, State
from tests.support.physics import STRETCH, changed, commands_of, moving, running, slack, stretch

PULL = 250.0
"""No servo pulls harder, in [N]."""


def pulled(robot: Robot, simulation: Simulation, seconds: float) -> Iterator[tuple[State, Array]]:
    """Pull in each copy the cable of its number in full; yield the state and the slack of every
    step."""
    command = -np.diag([servo.eta for servo in robot.servos])
    for _ in range(round(seconds / robot.time_step)):
        simulation.step(command)
        yield simulation.state(), slack(robot, simulation)


def test_cables_pull_only_when_taut_and_hardly_stretch(robot: Robot, engine: str) -> None:
    """No engine has tension in a step that a cable begins and ends slack, but for the curvature of
    the motion, which opens a gap of about a micrometre under 240 N."""
    most = 0.0
    with running(robot, engine, robot.num_cables) as simulation:
        before = slack(robot, simulation)
        for state, after in pulled(robot, simulation, 0.6):
            assert state.cable_tension.min() >= 0
            assert (state.cable_tension * np.minimum(before, after).clip(0)).max() < 1e-3  # [N m]
            most, before = max(most, -after.min()), after
        assert np.diagonal(simulation.state().cable_tension).min() > 200
        assert most <= stretch(simulation, PULL)


def test_a_moving_robot_does_not_stretch_its_cables(robot: Robot, stiff_engine: str) -> None:
    """Full commands jump every few steps, so that cables go slack and are torn taut by sliders and
    arm.

    Unhindered, sliders would move 6 mm too far in a step.
    """
    torn, most, copies = 0, 0.0, 8
    eta = np.array([servo.eta for servo in robot.servos])
    jumps = np.random.default_rng(0).random((15, copies, robot.num_cables)) < 0.4
    with running(robot, stiff_engine, copies) as simulation:
        before = slack(robot, simulation)
        for command in np.repeat(-eta * jumps, 7, axis=0):
            simulation.step(command)
            after, tension = slack(robot, simulation), simulation.state().cable_tension
            torn += ((before > 1e-4) & (tension > 0)).sum()
            most, before = max(most, -after.min()), after
    assert torn > 20
    assert most <= STRETCH


def test_cables_pass_on_all_the_work(robot: Robot, stiff_engine: str) -> None:
    """The work that tensions take from the sliders is the work that they do on the joints.

    The work on the joints in a step is the tension times the fall of the length without the
    slider's part, from the difference of two lengths. The two may differ by the work of stretching,
    250 N times a millionth of a metre, of 4 to 14 J.
    """
    route, still = routing(robot), np.zeros((robot.num_cables, robot.num_cables))
    taken, done = np.zeros_like(still), np.zeros_like(still)
    with running(robot, stiff_engine, robot.num_cables) as simulation:
        last = simulation.state()
        for state, _ in pulled(robot, simulation, 0.4):
            pulled_in = last.cable_travel - state.cable_travel  # a pull is a negative travel
            taken += state.cable_tension * pulled_in
            lengths = [cable_lengths(route, still, each.joint_angles) for each in (last, state)]
            done += state.cable_tension * (lengths[0] - lengths[1])
            last = state
    stretching = PULL * 1e-6
    np.testing.assert_allclose(done.diagonal(), taken.diagonal(), rtol=0, atol=stretching)
    assert taken.diagonal().min() > 100 * stretching


def test_the_tensions_reported_are_those_that_act(robot: Robot, engine: str) -> None:
    """M qdd + bias = passive + servos - L^T tensions holds in a short step from moving states with
    taut cables.

    The rows of the base show that no tension pushes it. The damping is C v before or after the
    step; in one of 1e-6 s this makes no more difference than h c / m = 1e-4 for a slider.
    """
    robot, cables, copies = changed(robot, time_step=1e-6), robot.num_cables, 4
    start = moving(robot, copies, bend=0.1)
    command = commands_of(robot, 1, copies)[0]
    with running(robot, engine, copies) as simulation:
        simulation.set_snapshot(start)
        before = simulation.dynamics()
        simulation.step(command)
        tension = simulation.state().cable_tension
        acceleration = (simulation.dynamics().velocity - before.velocity) / robot.time_step
    assert (tension > 1).sum() >= 3
    force = before.passive_force - before.bias_force
    gain = np.array([servo.gain for servo in robot.servos])
    force[:, 6 : 6 + cables] += gain * (command - start.position[:, 7 : 7 + cables])
    force -= np.einsum("nci,nc->ni", before.cable_jacobian, tension)
    expected = np.linalg.solve(before.mass_matrix, force[..., None])[..., 0]
    np.testing.assert_allclose(acceleration, expected, atol=3e-4 * np.abs(expected).max())
