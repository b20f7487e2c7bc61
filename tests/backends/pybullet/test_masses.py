"""Masses that are set after loading: PyBullet caches those that it was first asked about."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import Make, commands_of, random_parameters
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed, with_parts


def test_old_masses_are_forgotten_however_many_there_were(
    make: Make, paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("backends.pybullet.equation.MOST_BODIES", 2)
    simulation = make("pybullet", paper)
    for factor in np.linspace(1, 3, 12):
        simulation.set_parameters(None, Parameters(base_mass=factor, link_mass=factor))
        sliders = sum(servo.mass for servo in paper.servos)
        expected = factor * (paper.total_mass - sliders) + sliders
        assert simulation.dynamics().mass_matrix[0, 0, 0] == pytest.approx(expected, rel=1e-12)


def test_a_fixed_base_stays_where_it_is_with_any_masses(make: Make, paper: Robot) -> None:
    robot = changed(paper, base=paper.model_dump()["base"] | {"mount": "fixed"})
    simulation = make("pybullet", robot)
    simulation.set_parameters(None, Parameters(base_mass=2.0, link_mass=1.5))
    for command in commands_of(robot, 20, hold=10):
        simulation.step(command)
    state = simulation.state()
    assert np.abs(state.joint_angles).max() > 0.01
    assert not state.base_position.any()
    assert state.base_quaternion[0].tolist() == [1, 0, 0, 0]


def test_a_flat_body_may_have_rounded_moments(make: Make, paper: Robot) -> None:
    """A tenth more of 2, 1 and 3 g m^2 makes the largest exceed the sum of the others by one
    rounding, which PyBullet would refuse."""
    moments = (0.002, 0.001, 0.003)
    assert 1.1 * 0.003 > 1.1 * 0.002 + 1.1 * 0.001
    heavy = with_parts(paper, link={"inertia": moments})
    copy, described = make("pybullet", heavy), make("mujoco", heavy)
    for simulation in (copy, described):
        simulation.set_parameters(None, Parameters(link_inertia=1.1))
    found, expected = (each.dynamics().mass_matrix for each in (copy, described))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_a_step_uses_the_masses_of_each_copy(make: Make, robot: Robot) -> None:
    """With slack cables and no dampers, only springs act: one step is the equation of motion, also
    of a base that is turned."""
    num = 3
    simulation = make("pybullet", robot, num)
    random = dataclasses.replace(
        random_parameters(robot, num), joint_damping=0, slider_damping=0, rest_length_offset=0.05
    )
    simulation.set_parameters(None, random)
    snapshot = simulation.get_snapshot()
    generator = np.random.default_rng(1)
    snapshot.position[:, 7 + robot.num_cables :] = generator.uniform(
        -0.05, 0.05, (num, robot.num_hinges)
    )
    snapshot.velocity[:] = generator.normal(size=snapshot.velocity.shape) * 0.3
    turns = Rotation.random(num, rng=generator)
    snapshot.position[:, 3:7] = turns.as_quat(scalar_first=True)
    simulation.set_snapshot(snapshot)
    equation = simulation.dynamics()
    tip = np.einsum("nij,nj->ni", equation.tip_jacobian, snapshot.velocity)
    np.testing.assert_allclose(simulation.state().tip_velocity, tip, rtol=0, atol=1e-9)
    simulation.step(np.zeros((num, robot.num_cables)))
    np.testing.assert_allclose(simulation.state().cable_tension, 0, atol=1e-9)
    load = equation.passive_force - equation.bias_force
    expected = (
        snapshot.velocity
        + robot.time_step * np.linalg.solve(equation.mass_matrix, load[..., None])[..., 0]
    )
    np.testing.assert_allclose(simulation.get_snapshot().velocity, expected, rtol=1e-8, atol=1e-8)
