"""Joints of a coupled segment bend alike, as linkage cables make them, and nothing else changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from backends.contract_suite.states import commands_of, running
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array
from controllers.jacobian import JacobianController
from tests.support.physics import changed, energy, momentum, walk, with_parts

COUPLED = load_robot("paper-coupled")
APART = {"mujoco": 1e-6, "mujoco-stock": 0.05, "pybullet": 1e-12, "pybullet-stock": 1e-4}
"""By how much hinges that bend alike may differ, in [rad]."""


def apart(angles: Array) -> float:
    """Return the largest difference between the hinges about one axis of one segment, in [rad]."""
    return float(np.ptp(angles.reshape(-1, 2, 6, 2), axis=2).max())


def test_coupled_joints_bend_alike(engine: str) -> None:
    commands = commands_of(COUPLED, 300)
    with running(COUPLED, engine) as simulation:
        furthest = 0.0
        for command in commands:
            simulation.step(command)
            angles = simulation.state().joint_angles
            furthest = max(furthest, float(np.abs(angles).max()))
            assert apart(angles) < APART[engine]
    assert furthest > 0.1


def test_coupled_joints_bend_alike_at_their_limits(engine: str) -> None:
    """One cable in full bends the first segment until its joints stop at 0.05 rad."""
    robot = with_parts(COUPLED, joint={"limit": 0.05})
    command = np.zeros((1, 8))
    command[0, 0] = -5.0
    with running(robot, engine) as simulation:
        simulation.step(command, 150)
        angles = simulation.state().joint_angles
        assert apart(angles) < APART[engine]
        assert np.abs(angles).max() == pytest.approx(0.05, abs=0.01)


def test_linkages_create_no_momentum_and_no_energy(engine: str) -> None:
    """From rest the momentum stays zero but for the integrator's error; with its servos held the
    robot only loses energy."""
    command = commands_of(COUPLED, 1, seed=1)[0]
    with running(COUPLED, engine) as simulation:
        before, fastest = energy(COUPLED, simulation, command)[0], 0.0
        for _ in range(60):
            simulation.step(command, 2)
            linear, angular, _ = momentum(simulation)
            base = simulation.state().base_velocity
            fastest = max(fastest, COUPLED.base.mass * float(np.linalg.norm(base)))
            now = energy(COUPLED, simulation, command)[0]
            assert now < before + 1e-9
            before = now
            if engine != "pybullet-stock":  # Bullet's damping of bodies takes momentum
                assert np.linalg.norm(linear) < 0.05 * fastest
                assert np.linalg.norm(angular) < 0.1 * fastest


def least_energy(robot: Robot, command: Array) -> Array:
    """Return the four angles of least potential energy, one for each segment and axis, in [rad].

    The energy is that of springs, and of servos whose cables are too long; the guides are placed by
    plain rotations.
    """
    stiffness = robot.segments[0].joint.stiffness
    gain = robot.servos[0].gain

    def taken_in(angles: Array) -> Array:
        turns = [np.eye(3), *(turn for _, turn in walk(robot, all_hinges(angles)))]
        found = []
        for count, segment in zip((6, 12), robot.segments, strict=True):
            for angle in np.deg2rad(segment.cables.angles_deg):
                x, y = 0.02 * np.cos(angle), 0.02 * np.sin(angle)
                bends = [low.T @ high for low, high in pairwise(turns[: count + 1])]
                spans = [turn @ [x, y, 0.02] - [x, y, -0.02] for turn in bends]
                found.append(float(np.sum(np.linalg.norm(spans, axis=1) - 0.04)))
        return np.array(found)

    def terms(angles: Array) -> Array:
        springs = np.sqrt(stiffness) * all_hinges(angles)
        return np.append(springs, np.sqrt(gain) * np.maximum(taken_in(angles) - command, 0))

    return least_squares(terms, np.zeros(4), xtol=1e-14, ftol=1e-14, gtol=1e-12).x


def all_hinges(angles: Array) -> Array:
    """Return the angles of 24 hinges from those of each segment about x and y."""
    return np.concatenate([np.tile(pair, 6) for pair in angles.reshape(2, 2)])


def test_a_settled_coupled_arm_has_the_least_potential_energy(stiff_engine: str) -> None:
    """The links are light, so that the arm settles soon; the pose does not depend on masses."""
    light = {"mass": 0.0118, "inertia": (1.6e-4, 1.6e-4, 3.7e-6)}
    robot = with_parts(COUPLED, link=light, joint={"damping": 2.0})
    command = np.array([-0.5, -0.1, 0.0, 0.0, -0.3, -0.4, 0.0, -0.1])
    with running(robot, stiff_engine) as simulation:
        simulation.step(command[None], 4000)
        state = simulation.state()
    assert np.abs(state.joint_rates).max() < 1e-4
    expected = least_energy(robot, command)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(state.joint_angles[0], all_hinges(expected), atol=1e-4)


def test_the_demonstrator_predicts_how_a_coupled_arm_moves() -> None:
    """Its linear prediction of the rates of the four free hinges over one step is what the engine
    does, to 5 % of the largest change."""
    controller, free = JacobianController(COUPLED), [0, 1, 12, 13]
    with running(COUPLED, "mujoco") as simulation:
        for command in commands_of(COUPLED, 100):
            simulation.step(command)
        offset, slope = controller._predict_hinges(simulation.dynamics(), COUPLED.time_step)
        before = simulation.state().joint_rates[0, free]
        simulation.step(np.full((1, 8), -1.0))
        state = simulation.state()
    found = state.joint_rates[0, free]
    predicted = offset[0] + slope[0] @ state.cable_tension[0]
    assert np.abs(predicted - found).max() < 0.05 * np.abs(found - before).max()


def test_different_rest_angles_cannot_be_coupled() -> None:
    data = load_robot("planar-single").model_dump()["segments"][0]
    bent = data["link"] | {"joint": data["joint"] | {"rest": (0.1, 0.0)}}
    chain = {"chain": (data["link"], bent), "joint": data["joint"], "coupling": "equal-angles"}
    with pytest.raises((CdcsrError, ValueError), match="same rest angle in all hinges about x"):
        changed(COUPLED, segments=[chain])
