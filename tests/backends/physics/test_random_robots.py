"""Any valid description is the same robot in every engine."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given

from backends.mujoco.simulation import MujocoSimulation
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array
from tests.support.physics import moving, running
from tests.support.random_robots import few, many, robots


def guide_by_guide(robot: Robot, travel: Array, hinges: Array) -> Array:
    """Length of every cable as the distances from point to point, shape (C,), in [m]; walks out
    along the arm."""
    cosine, sine = np.cos(hinges), np.sin(hinges)
    turns = np.stack([cosine[::2], sine[::2], cosine[1::2], sine[1::2]], axis=1)
    crossed = [(link.length, *turn) for (link, _), turn in zip(robot.links, turns, strict=True)]
    lengths, number, last = [], 0, 0
    for segment in robot.segments:
        cables, last = segment.cables, last + segment.links
        for angle in np.deg2rad(cables.angles_deg):
            x, y = cables.pitch_radius * np.cos(angle), cables.pitch_radius * np.sin(angle)
            first = robot.base.size[2] / 2 - cables.guide_offset
            points = [
                np.array([x, y, first - segment.servo.offset + travel[number]]),
                np.array([x, y, first]),
            ]
            turned, place = np.eye(3), np.array([0, 0, robot.base.size[2] / 2])
            for length, cx, sx, cy, sy in crossed[:last]:
                about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
                turned = turned @ about_x @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
                points += [
                    place + turned @ [x, y, z]
                    for z in (cables.guide_offset, length - cables.guide_offset)
                ]
                place = place + turned @ [0, 0, length]
            lengths.append(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            number += 1
    return np.array(lengths)


def same_robot_in_every_engine(robot: Robot) -> None:
    """At tilted, spinning, bent states: mass matrix, Jacobians and bias to 1e-10, cable lengths to
    1e-9 m."""
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
            assert apart.max() < 1e-10
            one.write_to(data, n)
            mujoco.mj_forward(one.model, data)
            closed_form = cable_lengths(route, travel[n], hinges[n])
            np.testing.assert_allclose(data.ten_length, closed_form, rtol=0, atol=1e-9)
            summed = guide_by_guide(robot, travel[n], hinges[n])
            np.testing.assert_allclose(summed, closed_form, rtol=0, atol=1e-9)
        for name in ("tip_jacobian", "cable_jacobian", "bias_force", "passive_force", "velocity"):
            found, expected = getattr(left, name), getattr(right, name)
            np.testing.assert_allclose(
                found, expected, rtol=0, atol=1e-10 * np.abs(expected).max(), err_msg=name
            )
        for name in ("tip_position", "tip_velocity", "base_angular_velocity"):
            np.testing.assert_allclose(
                *(getattr(state, name) for state in states), rtol=0, atol=1e-10, err_msg=name
            )
        for simulation in (one, other):
            simulation.reset()
            simulation.step(np.full((3, cables), -0.1), 20)  # it does not diverge
            assert simulation.state().cable_tension.min() >= 0


@few
@given(robots())
def test_a_random_robot_is_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)


@pytest.mark.slow
@many
@given(robots())
def test_many_random_robots_are_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)
