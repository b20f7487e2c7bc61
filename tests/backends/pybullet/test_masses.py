"""Masses that are set after loading: PyBullet caches those that it was first asked about."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from backends.contract_suite.states import Make, random_parameters
from cdcsr.robot.description import Robot
from cdcsr.simulation.plant import Parameters


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


def test_a_step_uses_the_masses_of_each_copy(make: Make, robot: Robot) -> None:
    """With slack cables and no dampers, only springs act: one step is the equation of motion."""
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
    simulation.set_snapshot(snapshot)
    equation = simulation.dynamics()
    simulation.step(np.zeros((num, robot.num_cables)))
    np.testing.assert_allclose(simulation.state().cable_tension, 0, atol=1e-9)
    load = equation.passive_force - equation.bias_force
    expected = (
        snapshot.velocity
        + robot.time_step * np.linalg.solve(equation.mass_matrix, load[..., None])[..., 0]
    )
    np.testing.assert_allclose(simulation.get_snapshot().velocity, expected, rtol=1e-8, atol=1e-8)
