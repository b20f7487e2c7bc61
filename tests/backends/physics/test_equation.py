"""Every engine's equation of motion, compared with finite differences, the described bodies and
closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import at, moving, running
from cdcsr.robot.description import Link, Robot
from cdcsr.robot.routing import cable_jacobian, routing
from cdcsr.simulation.contract import Array, Snapshot
from tests.support.physics import changed, described_bodies


def moved(robot: Robot, position: Array, velocity: Array, time: float) -> Snapshot:
    """Return the state after a time at constant velocities; the base turns about the world's
    axes."""
    turn = Rotation.from_rotvec(time * velocity[3:6]) * Rotation.from_quat(
        position[3:7], scalar_first=True
    )
    further = position.copy()
    further[:3] += time * velocity[:3]
    further[3:7] = turn.as_quat(scalar_first=True)
    further[7:] += time * velocity[6:]
    return at(robot, further[None], velocity[None])


def test_tip_jacobian_is_the_derivative_of_the_tips_position(robot: Robot, engine: str) -> None:
    """Each column is compared with central differences over 2e-5 s at a unit velocity."""
    step, position, tips = 1e-5, moving(robot, 1).position[0], []
    with running(robot, engine) as simulation:
        for unit in np.eye(robot.num_coordinates):
            for time in (step, -step, 0):
                simulation.set_snapshot(moved(robot, position, unit, time))
                tips.append(simulation.state().tip_position[0])
            # In the last of these states the velocity of the tip is this column.
            np.testing.assert_allclose(
                simulation.state().tip_velocity[0], (tips[-3] - tips[-2]) / (2 * step), atol=1e-8
            )
        jacobian = simulation.dynamics().tip_jacobian[0]
    columns = (np.array(tips[0::3]) - tips[1::3]) / (2 * step)
    np.testing.assert_allclose(jacobian.T, columns, atol=1e-8)


def energy_body_by_body(robot: Robot, snapshot: Snapshot, copy: int) -> float:
    """Return the kinetic energy in [J], summed body by body from the base to the tip."""
    cables, position, velocity = robot.num_cables, snapshot.position[copy], snapshot.velocity[copy]
    linear, angular = velocity[:3], velocity[3:6]
    frame = Rotation.from_quat(position[3:7], scalar_first=True)
    total = 0.0

    def add(mass: float, inertia: Array, offset: Array, own: Array) -> None:
        """Add a body whose centre is at `offset` in the present frame and moves at `own` in it."""
        speed = linear + np.cross(angular, frame.apply(offset)) + frame.apply(own)
        spin = frame.inv().apply(angular)
        nonlocal total
        total += 0.5 * mass * speed @ speed + 0.5 * spin @ (inertia * spin)

    add(robot.base.mass, np.array(robot.base.inertia), np.zeros(3), np.zeros(3))
    up = np.array([0.0, 0.0, 1.0])
    sliders = [body for body in described_bodies(robot) if body[0].startswith("slider")]
    for c, (_, mass, inertia, place) in enumerate(sliders):
        add(mass, np.array(inertia), np.array(place) + up * position[7 + c], up * velocity[6 + c])
    joint = np.array([0, 0, robot.base.size[2] / 2])
    for j, (link, _) in enumerate(robot.links):
        linear = linear + np.cross(angular, frame.apply(joint))
        for axis, unit in enumerate(np.eye(3)[:2]):
            hinge = cables + 2 * j + axis
            angular = angular + frame.apply(unit) * velocity[6 + hinge]
            frame = frame * Rotation.from_rotvec(unit * position[7 + hinge])
        add(link.mass, np.array(link.inertia), middle(link), np.zeros(3))
        joint = 2 * middle(link)
    return total


def middle(link: Link) -> Array:
    return np.array([0, 0, link.length / 2])


def test_mass_matrix_gives_the_kinetic_energy_of_the_bodies(robot: Robot, engine: str) -> None:
    snapshot = moving(robot, 4, bend=0.8)
    with running(robot, engine, 4) as simulation:
        simulation.set_snapshot(snapshot)
        equation = simulation.dynamics()
    for copy in range(4):
        speed = equation.velocity[copy]
        kinetic = 0.5 * speed @ equation.mass_matrix[copy] @ speed
        assert kinetic == pytest.approx(energy_body_by_body(robot, snapshot, copy), rel=1e-12)
    np.testing.assert_allclose(
        equation.mass_matrix, equation.mass_matrix.swapaxes(1, 2), rtol=1e-12, atol=1e-12
    )


def test_passive_forces_are_the_described_springs_and_dampers(robot: Robot, engine: str) -> None:
    snapshot, cables = moving(robot, 2), robot.num_cables
    with running(robot, engine, 2) as simulation:
        simulation.set_snapshot(snapshot)
        passive = simulation.dynamics().passive_force
    joints = [joint for _, joint in robot.links for _ in "xy"]
    stiffness = np.array([0.0] * cables + [joint.stiffness for joint in joints])
    damping = np.array(
        [servo.damping for servo in robot.servos] + [joint.damping for joint in joints]
    )
    expected = -stiffness * snapshot.position[:, 7:] - damping * snapshot.velocity[:, 6:]
    np.testing.assert_allclose(passive[:, 6:], expected, rtol=1e-12)
    np.testing.assert_array_equal(passive[:, :6], 0)


def test_cable_jacobian_is_the_closed_forms(robot: Robot, engine: str) -> None:
    """The closed form itself is tested in tests/cdcsr. A motion of the base changes no length."""
    snapshot, cables = moving(robot, 4, bend=0.8), robot.num_cables
    with running(robot, engine, 4) as simulation:
        simulation.set_snapshot(snapshot)
        jacobian = simulation.dynamics().cable_jacobian
    travel, hinges = snapshot.position[:, 7 : 7 + cables], snapshot.position[:, 7 + cables :]
    np.testing.assert_allclose(
        jacobian[:, :, 6:], cable_jacobian(routing(robot), travel, hinges), atol=1e-12
    )
    np.testing.assert_allclose(jacobian[:, :, :6], 0, atol=1e-12)


def test_bias_is_the_force_of_free_motion(robot: Robot, engine: str) -> None:
    """Along a free motion M v' = -bias, and the rate of the kinetic energy, v.M v' + 1/2 v.M' v, is
    zero, so v.bias = 1/2 v.M' v; M' is found by central differences along the velocity."""
    step, snapshot, around = 1e-5, moving(robot, 1, bend=0.5), []
    position, velocity = snapshot.position[0], snapshot.velocity[0]
    with running(robot, engine) as simulation:
        for time in (step, -step, 0):
            simulation.set_snapshot(moved(robot, position, velocity, time))
            around.append(simulation.dynamics())
    change = (around[0].mass_matrix[0] - around[1].mass_matrix[0]) / (2 * step)
    assert velocity @ around[2].bias_force[0] == pytest.approx(
        0.5 * velocity @ change @ velocity, rel=1e-6, abs=1e-6
    )
    # No external force acts, so the momentum in the base's linear rows is constant: bias is M' v.
    np.testing.assert_allclose(
        around[2].bias_force[0, :3], change[:3] @ velocity, rtol=1e-6, atol=1e-6
    )


def test_a_payload_is_a_body_at_the_tip(robot: Robot, engine: str) -> None:
    """A point adds m J' J to the mass matrix, where J is the tip's Jacobian."""
    start = moving(robot, 1)
    matrices, tip = [], np.zeros(0)
    for payload in (None, {"mass": 0.7}):
        with running(changed(robot, payload=payload), engine) as simulation:
            state = at(simulation.robot, start.position, start.velocity)
            simulation.set_snapshot(state)
            equation = simulation.dynamics()
            matrices.append(equation.mass_matrix[0])
            tip = equation.tip_jacobian[0]
    np.testing.assert_allclose(matrices[1] - matrices[0], 0.7 * tip.T @ tip, atol=1e-9)
