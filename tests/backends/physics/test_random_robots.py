"""Any valid description is the same robot in every engine."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings

from backends.contract_suite.states import moving, running
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed, energy, walk
from tests.support.random_robots import arms, few, many, robots


def guide_by_guide(robot: Robot, travel: Array, hinges: Array) -> Array:
    """Length of every cable as the distances from point to point, shape (C,), in [m]; walks out
    along the arm."""
    lengths, last = [], 0
    walked = walk(robot, hinges)
    joints = np.cumsum([0.0] + [link.length for link, _ in robot.links])
    for segment in robot.segments:
        last += segment.links
        for way in segment.cables.ways if segment.cable_angles else ():
            o, near = segment.cables.guide_offset, way.pitch_radius or segment.cables.pitch_radius
            far, end = way.end_pitch_radius or near, last
            end = last if way.last_link is None else way.last_link + 1
            bottom, top = joints[way.first_link] - o, joints[end] - o
            slack = segment.servo.offset - travel[len(lengths)]
            length, before = abs(slack), None
            for j in range(way.first_link - 1, end):
                place, turn = walked[j] if j >= 0 else (np.zeros(3), np.eye(3))
                foot = joints[j] if j >= 0 else -robot.first_joint
                for z in [joints[j] + o] * (j >= way.first_link) + [joints[j + 1] - o]:
                    part = (z - bottom) / (top - bottom)
                    angle = np.deg2rad(way.angle_deg + way.twist_deg * part)
                    across = [np.cos(angle), np.sin(angle)]
                    point = np.append((near + (far - near) * part) * np.array(across), z - foot)
                    point = place + turn @ point
                    length += 0.0 if before is None else np.linalg.norm(point - before)
                    before = point
            lengths.append(float(length))
    return np.array(lengths)


def same_robot_in_every_engine(robot: Robot) -> None:
    """At tilted, spinning, bent states: mass matrix to 1e-9 (links of millimetres round as much),
    Jacobians and bias to 1e-10, cable lengths to 1e-9 m."""
    snapshot, route, cables = moving(robot, 3, bend=0.5), routing(robot), robot.num_cables
    travel, hinges = snapshot.position[:, 7 : 7 + cables], snapshot.position[:, 7 + cables :]
    with running(robot, "mujoco", 3) as one, running(robot, "pybullet", 3) as other:
        one.set_snapshot(snapshot)
        other.set_snapshot(snapshot)
        left, right, states = one.dynamics(), other.dynamics(), (one.state(), other.state())
        assert isinstance(one, MujocoSimulation)
        data = mujoco.MjData(one.model)
        for n in range(3):
            size = np.sqrt(np.diag(left.mass_matrix[n]))
            apart = np.abs(left.mass_matrix[n] - right.mass_matrix[n]) / np.outer(size, size)
            assert apart.max() < 1e-9
            one.write_to(data, n)
            mujoco.mj_forward(one.model, data)
            closed_form = cable_lengths(route, travel[n], hinges[n])
            np.testing.assert_allclose(data.ten_length[:cables], closed_form, rtol=0, atol=1e-9)
            summed = guide_by_guide(robot, travel[n], hinges[n])
            np.testing.assert_allclose(summed, closed_form, rtol=0, atol=1e-9)
        for name in ("tip_jacobian", "cable_jacobian", "bias_force", "passive_force", "velocity"):
            found, expected = getattr(left, name), getattr(right, name)
            largest = np.abs(expected).max(initial=0.0)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * largest, err_msg=name)
        for name in ("tip_position", "tip_velocity", "base_angular_velocity"):
            np.testing.assert_allclose(
                *(getattr(state, name) for state in states), rtol=0, atol=1e-10, err_msg=name
            )
        for simulation in (one, other):
            simulation.reset()
            simulation.step(np.full((3, cables), -0.1), 20)  # it does not diverge
            assert simulation.state().cable_tension.min(initial=0.0) >= 0


def one_step_obeys_the_equation(robot: Robot) -> None:
    """A step h from any state under any loads, without dampers, with slack cables and idle servos,
    changes the velocity by h M^-1 (passive - bias), to the first order in h."""
    quick = changed(robot, time_step=1e-6, constraint={"recovery_time": 1e-5})
    start, cables, random = moving(quick, 2, bend=0.4), robot.num_cables, np.random.default_rng(1)
    travel, pull = start.position[:, 7 : 7 + cables], [servo.pretension for servo in robot.servos]
    stops = [servo.offset - servo.radius for servo in robot.servos]
    np.minimum(travel, 0.9 * np.array(stops), out=travel)  # no slider is past its guide
    by_travel = np.array([servo.stiffness for servo in robot.servos])
    idle = np.where(by_travel > 0, travel + pull / np.maximum(by_travel, 1e-9), np.negative(pull))
    rough = any(robot.guide_friction)
    if rough:
        with pytest.raises(CdcsrError, match="mujoco-stock has no friction in guides; leave out"):
            make_simulation(robot, "mujoco-stock")
    for engine in ("mujoco", "pybullet") if rough else ("mujoco", "mujoco-stock", "pybullet"):
        with running(quick, engine, 2) as simulation:
            parameters = Parameters(joint_damping=0.0, slider_damping=0.0, rest_length_offset=1.0)
            simulation.set_parameters(None, parameters)
            for link in {0, robot.num_links - 1}:
                vectors = random.uniform(-0.5, 0.5, (2, 2, 3))
                simulation.set_loads(None, link, *vectors, point=(0.02, -0.03, 0.05))
            simulation.set_snapshot(start)
            equation, before = simulation.dynamics(), simulation.get_snapshot()
            force = equation.passive_force - equation.bias_force
            expected = np.linalg.solve(equation.mass_matrix, force[..., None])[..., 0]
            simulation.step(idle)
            found = (simulation.get_snapshot().velocity - before.velocity) / quick.time_step
            assert simulation.state().cable_tension.max(initial=0.0) == 0
        off = np.abs(found - expected) / np.abs(expected).max(axis=1, keepdims=True)
        assert off.max() < 2e-3, engine


def shorter(robot: Robot) -> Robot:
    """Return the robot with at most two segments of at most three links."""
    segments = [
        segment | {"links": min(segment["links"], 3)}
        for segment in robot.model_dump()["segments"][:2]
    ]
    return changed(robot, segments=segments)


def rubbing_only_takes_energy_and_carries_on(robot: Robot, engine: str) -> None:
    """Undamped and pulled from rest, one copy rubs and the other does not; a snapshot on the way
    goes on as the first run does."""
    added = np.maximum(0.2 - np.array(robot.guide_friction), 0)
    smooth = -np.array(robot.guide_friction)
    plant = Parameters(joint_damping=0.0, slider_damping=0.0, guide_friction=[added, smooth])
    command = np.tile(0.5 * np.array(robot.full_commands), (2, 1))
    command[:, 1::2] = 0
    with running(robot, engine, 2) as one, running(robot, engine, 2) as other:
        for simulation in (one, other):
            simulation.set_parameters(None, plant)
            simulation.reset()
        left = [energy(robot, one, command)]
        for block in range(10):
            if block == 5:
                other.set_snapshot(one.get_snapshot())
            for simulation in (one, other)[: 1 + (block >= 5)]:
                simulation.step(command, 20)
            left.append(energy(robot, one, command))
        position = (simulation.get_snapshot().position for simulation in (one, other))
        np.testing.assert_allclose(*position, rtol=0, atol=1e-8)
    rises = np.diff(left, axis=0).max(axis=0)
    assert rises[0] < max(rises[1], 0) + 1e-6 * left[0][0]  # the integrator's, and rounding
    assert left[-1][0] < left[-1][1]


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
@settings(few, max_examples=3)
@given(robots().map(shorter))
def test_rubbing_only_takes_energy_and_carries_on(engine: str, robot: Robot) -> None:
    rubbing_only_takes_energy_and_carries_on(robot, engine)


@few
@given(arms())
def test_any_arm_is_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)


@few
@given(arms())
def test_any_arm_obeys_its_equation_of_motion(robot: Robot) -> None:
    one_step_obeys_the_equation(robot)


@pytest.mark.slow
@many
@given(arms())
def test_many_arms_are_the_same_in_every_engine_and_obey_their_equation(robot: Robot) -> None:
    same_robot_in_every_engine(robot)
    one_step_obeys_the_equation(robot)


@few
@given(robots())
def test_a_random_robot_is_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)


@pytest.mark.slow
@many
@given(robots())
def test_many_random_robots_are_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)
