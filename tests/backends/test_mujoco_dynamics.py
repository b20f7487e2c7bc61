"""The MuJoCo model and its equation of motion against the description and mechanics done by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.mujoco.model import build_spec
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.cables import cable_jacobian, cable_lengths, routing
from cdcsr.robot import Link, Robot, load_robot, shipped_robots
from cdcsr.simulation import Array, Snapshot, rotation_matrix


@pytest.fixture(params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def paper() -> Robot:
    return load_robot("paper")


def moving(robot: Robot, num: int, bend: float = 0.3, seed: int = 0) -> Snapshot:
    """Turned, bent robots with every coordinate in motion, as a snapshot that any engine takes."""
    rng, cables, hinges = np.random.default_rng(seed), robot.num_cables, robot.num_hinges
    turn = Rotation.random(num, rng=rng).as_quat(scalar_first=True)
    place = [rng.uniform(-1, 1, (num, 3)), turn, rng.uniform(-0.05, 0.05, (num, cables))]
    position = np.concatenate([*place, rng.uniform(-bend, bend, (num, hinges))], axis=1)
    velocity = rng.uniform(-1, 1, (num, robot.num_coordinates))
    return Snapshot("by hand", robot.fingerprint, np.zeros(num), position, velocity, np.zeros((num, 0)))


# --- the model is the description --------------------------------------------------------------------------------


def described_bodies(robot: Robot) -> Iterator[tuple[str, float, tuple[float, float, float], Any]]:
    """Name, mass, inertia, and centre of mass of the straight robot in the world, of every body."""
    yield "base", robot.base.mass, robot.base.inertia, (0, 0, 0)
    cable, height = 0, robot.base.size[2] / 2
    for segment in robot.segments:
        cables, servo = segment.cables, segment.servo
        for angle in np.deg2rad(cables.angles_deg):
            x, y = cables.pitch_radius * np.cos(angle), cables.pitch_radius * np.sin(angle)
            z = robot.base.size[2] / 2 - cables.guide_offset - servo.offset
            moment = 2 / 5 * servo.mass * servo.radius**2  # a solid ball
            yield f"slider_{cable}", servo.mass, (moment, moment, moment), (x, y, z)
            cable += 1
    number = 0
    for segment in robot.segments:
        for _ in range(segment.links):
            yield f"link_{number}", segment.link.mass, segment.link.inertia, (0, 0, height + segment.link.length / 2)
            height += segment.link.length
            number += 1


def test_bodies_have_the_described_mass_inertia_and_center(robot: Robot) -> None:
    model = build_spec(robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = list(described_bodies(robot))
    assert model.nbody == 1 + len(expected)
    for name, mass, inertia, center in expected:
        body = model.body(name)
        assert body.mass == mass
        principal = rotation_matrix(body.iquat)  # the compiler may sort the moments and turn their frame
        np.testing.assert_allclose(principal @ np.diag(body.inertia) @ principal.T, np.diag(inertia), atol=1e-12)
        np.testing.assert_allclose(data.body(name).xipos, center, atol=1e-12)
    total = sum(mass for _, mass, _, _ in expected)
    np.testing.assert_allclose(data.subtree_com[0], sum(m * np.array(c) for _, m, _, c in expected) / total, atol=1e-12)


def test_center_of_mass_of_the_papers_robot(paper: Robot) -> None:
    """8 sliders of 0.2 kg at z = 0.3 - 0.02 - 0.2; 12 links of 1.18 kg with their middle at z = 0.3 + 1.2."""
    model = build_spec(paper).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    total = 500 + 8 * 0.2 + 12 * 1.18
    assert model.body("base").subtreemass == pytest.approx(total)
    height = (8 * 0.2 * 0.08 + 12 * 1.18 * 1.5) / total
    np.testing.assert_allclose(data.subtree_com[0], [0, 0, height], atol=1e-12)


def test_joints_have_the_described_springs_dampers_and_limits(robot: Robot) -> None:
    model = build_spec(robot).compile()
    for j, (_, joint) in enumerate(robot.links):
        for axis in "xy":
            hinge = model.joint(f"hinge_{j}_{axis}")
            assert (hinge.stiffness[0], hinge.damping[0]) == (joint.stiffness, joint.damping)
            assert hinge.range.tolist() == [-joint.limit, joint.limit]
    for c, servo in enumerate(robot.servos):
        assert model.joint(f"slide_{c}").damping[0] == servo.damping
        assert model.actuator(f"servo_{c}").gainprm[0] == servo.gain
        assert model.actuator(f"servo_{c}").biasprm[:3].tolist() == [0, -servo.gain, 0]
    assert model.opt.timestep == robot.time_step
    assert not model.opt.gravity.any()


# --- dynamics ----------------------------------------------------------------------------------------------------


def test_coordinates_are_in_the_contracts_order(robot: Robot) -> None:
    """A snapshot's numbers come out of the state under the right names."""
    simulation, snapshot = MujocoSimulation(robot, 3), moving(robot, 3)
    simulation.set_snapshot(snapshot)
    state, cables = simulation.state(), robot.num_cables
    position, velocity = snapshot.position, snapshot.velocity
    np.testing.assert_array_equal(state.base_position, position[:, :3])
    np.testing.assert_allclose(state.base_quaternion, position[:, 3:7], rtol=1e-12)
    np.testing.assert_array_equal(state.cable_travel, position[:, 7 : 7 + cables])
    np.testing.assert_array_equal(state.joint_angles, position[:, 7 + cables :])
    np.testing.assert_array_equal(state.base_velocity, velocity[:, :3])
    np.testing.assert_allclose(state.base_angular_velocity, velocity[:, 3:6], atol=1e-12)
    np.testing.assert_array_equal(state.joint_rates, velocity[:, 6 + cables :])
    np.testing.assert_allclose(simulation.dynamics().velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(simulation.get_snapshot().velocity, velocity, atol=1e-12)


def moved(snapshot: Snapshot, time: float) -> Snapshot:
    """Every coordinate carried on at its velocity; the base turns about the world's axes."""
    turn = Rotation.from_rotvec(time * snapshot.velocity[:, 3:6])
    base = turn * Rotation.from_quat(snapshot.position[:, 3:7], scalar_first=True)
    position = snapshot.position.copy()
    position[:, :3] += time * snapshot.velocity[:, :3]
    position[:, 3:7] = base.as_quat(scalar_first=True)
    position[:, 7:] += time * snapshot.velocity[:, 6:]
    return dataclasses.replace(snapshot, position=position)


def tips(simulation: MujocoSimulation, snapshot: Snapshot) -> Array:
    simulation.set_snapshot(snapshot)
    return simulation.state().tip_position


def test_tip_jacobian_is_the_derivative_of_the_tips_position(robot: Robot) -> None:
    """Column by column, a unit velocity each, by central differences over 2e-5 s."""
    num, step = robot.num_coordinates, 1e-5
    simulation = MujocoSimulation(robot, num)
    one = moving(robot, 1)
    each = dataclasses.replace(
        one, time=np.zeros(num), position=np.repeat(one.position, num, axis=0), velocity=np.eye(num),
        private=np.zeros((num, 0)),
    )  # fmt: skip
    simulation.set_snapshot(each)
    jacobian = simulation.dynamics([0]).tip_jacobian[0]
    velocity = simulation.state().tip_velocity
    columns = (tips(simulation, moved(each, step)) - tips(simulation, moved(each, -step))) / (2 * step)
    np.testing.assert_allclose(jacobian.T, columns, atol=1e-8)
    np.testing.assert_allclose(velocity, columns, atol=1e-8)


def test_cables_are_those_of_the_closed_form(robot: Robot) -> None:
    simulation, route, cables = MujocoSimulation(robot, 4), routing(robot), robot.num_cables
    snapshot = moving(robot, 4, bend=0.8)
    simulation.set_snapshot(snapshot)
    travel, hinges = snapshot.position[:, 7 : 7 + cables], snapshot.position[:, 7 + cables :]
    jacobian = simulation.dynamics().cable_jacobian
    np.testing.assert_allclose(jacobian[:, :, 6:], cable_jacobian(route, travel, hinges), atol=1e-12)
    np.testing.assert_allclose(jacobian[:, :, :6], 0, atol=1e-12)  # moving the base changes no length
    data = mujoco.MjData(simulation.model)
    for copy in range(4):
        simulation.write_to(data, copy)
        mujoco.mj_forward(simulation.model, data)
        np.testing.assert_allclose(data.ten_length, cable_lengths(route, travel[copy], hinges[copy]), rtol=1e-13)


def energy_body_by_body(robot: Robot, snapshot: Snapshot, copy: int) -> float:
    """Kinetic energy in [J], with every body's frame and velocity found by walking out along the arm."""
    cables, position, velocity = robot.num_cables, snapshot.position[copy], snapshot.velocity[copy]
    origin, linear, angular = position[:3], velocity[:3], velocity[3:6]
    frame = Rotation.from_quat(position[3:7], scalar_first=True)
    total = 0.0

    def add(mass: float, inertia: Any, offset: Array, own: Array) -> None:
        """A body with its centre at `offset` in the present frame, sliding at `own` in it."""
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
        origin = origin + frame.apply(joint)
        for axis, unit in enumerate(np.eye(3)[:2]):
            at = cables + 2 * j + axis
            angular = angular + frame.apply(unit) * velocity[6 + at]
            frame = frame * Rotation.from_rotvec(unit * position[7 + at])
        add(link.mass, np.array(link.inertia), middle(link), np.zeros(3))
        joint = 2 * middle(link)
    return total


def middle(link: Link) -> Array:
    return np.array([0, 0, link.length / 2])


def test_mass_matrix_gives_the_kinetic_energy_of_the_bodies(robot: Robot) -> None:
    simulation, snapshot = MujocoSimulation(robot, 4), moving(robot, 4, bend=0.8)
    simulation.set_snapshot(snapshot)
    equation = simulation.dynamics()
    for copy in range(4):
        speed = equation.velocity[copy]
        energy = 0.5 * speed @ equation.mass_matrix[copy] @ speed
        assert energy == pytest.approx(energy_body_by_body(robot, snapshot, copy), rel=1e-12)
    np.testing.assert_allclose(equation.mass_matrix, equation.mass_matrix.swapaxes(1, 2), rtol=1e-12, atol=1e-12)


def test_passive_forces_are_the_described_springs_and_dampers(robot: Robot) -> None:
    simulation, snapshot, cables = MujocoSimulation(robot, 2), moving(robot, 2), robot.num_cables
    simulation.set_snapshot(snapshot)
    joints = [joint for _, joint in robot.links for _ in "xy"]
    stiffness = np.array([0.0] * cables + [joint.stiffness for joint in joints])
    damping = np.array([servo.damping for servo in robot.servos] + [joint.damping for joint in joints])
    expected = -stiffness * snapshot.position[:, 7:] - damping * snapshot.velocity[:, 6:]
    passive = simulation.dynamics().passive_force
    np.testing.assert_allclose(passive[:, 6:], expected, rtol=1e-12)
    np.testing.assert_array_equal(passive[:, :6], 0)


def test_the_equation_of_motion_predicts_a_step(robot: Robot) -> None:
    """With slack cables and nothing at a limit, M qdd + bias = passive + servos, the damping taken implicitly."""
    cables, step = robot.num_cables, 1e-6
    robot = Robot.model_validate(robot.model_dump() | {"time_step": step})
    slack = moving(robot, 2, bend=0.1)
    slack.position[:, 7 : 7 + cables] = 0.05  # paid out, so no cable is at its limit
    simulation = MujocoSimulation(robot, 2)
    simulation.set_snapshot(slack)
    before = simulation.dynamics()
    command = np.random.default_rng(0).uniform(-1, 0, (2, cables))
    simulation.step(command)
    assert not simulation.state().cable_tension.any()
    servo = np.zeros_like(before.velocity)
    gain = np.array([servo.gain for servo in robot.servos])
    servo[:, 6 : 6 + cables] = gain * (command - slack.position[:, 7 : 7 + cables])
    net = before.passive_force + servo - before.bias_force
    expected = np.linalg.solve(before.mass_matrix, net[..., None])[..., 0]
    found = (simulation.dynamics().velocity - before.velocity) / step
    np.testing.assert_allclose(found, expected, rtol=1e-2, atol=1e-3 * np.abs(expected).max())
