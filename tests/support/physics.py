"""Helpers for tests of physics: changed robots, states, commands, and conserved quantities.

They know no engine and measure everything through the contract.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array, Dynamics, Simulation, Snapshot, State
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters

STRETCH = 0.05e-3
"""A cable that is not soft may be longer than at rest by this, in [m]."""


class Make(Protocol):
    """Makes a simulation in the engine of a name; the fixture `make` closes it."""

    def __call__(self, engine: str, robot: Robot, num: int = 1) -> Simulation: ...


@contextmanager
def running(robot: Robot, engine: str, num: int = 1) -> Iterator[Simulation]:
    """Yield a simulation that is closed at the end."""
    simulation = make_simulation(robot, engine, num)
    try:
        yield simulation
    finally:
        simulation.close()


def changed(robot: Robot, **keys: object) -> Robot:
    """Return the robot with some top-level keys replaced, validated as if read from a file."""
    return Robot.model_validate(robot.model_dump() | keys)


def with_parts(robot: Robot, **parts: Mapping[str, object]) -> Robot:
    """Return the robot with numbers of a part (``link``, ``joint``, ...) replaced in all
    segments."""
    segments = [
        segment | {part: segment[part] | numbers for part, numbers in parts.items()}
        for segment in robot.model_dump()["segments"]
    ]
    return changed(robot, segments=segments)


def finer(robot: Robot, divide: int) -> Robot:
    """Return the robot with its time step divided, and the same recovery time."""
    return changed(robot, time_step=robot.time_step / divide)


def commands_of(robot: Robot, steps: int, num: int = 1, seed: int = 0, hold: int = 20) -> Array:
    """Return random commands, shape (steps, num, C), each held for some steps, so that the arm
    moves."""
    draws = (
        np.random.default_rng(seed).uniform(-1, 0, (-(-steps // hold), num, robot.num_cables))
        * -robot.full_commands
    )
    return np.repeat(draws, hold, axis=0)[:steps]


def at(robot: Robot, position: Array, velocity: Array) -> Snapshot:
    """Return a state as a snapshot that every engine takes."""
    num = len(position)
    return Snapshot(
        "by hand", robot.fingerprint, np.zeros(num), position, velocity, np.zeros((num, 0))
    )


Triple = tuple[float, float, float]


def described_bodies(robot: Robot) -> Iterator[tuple[str, float, Triple, Triple]]:
    """Yield name, mass, inertia, and centre of mass in the straight robot, of every body."""
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
            yield (
                f"link_{number}",
                segment.link.mass,
                segment.link.inertia,
                (0, 0, height + segment.link.length / 2),
            )
            height += segment.link.length
            number += 1


def walk(robot: Robot, hinges: Array) -> list[tuple[Array, Rotation]]:
    """Return the place of each link's joint in [m], and how the link is turned, in the base's frame
    at hinge angles of shape (H,); walks out along the arm."""
    found, left = [], list(hinges)
    place, turn = np.array([0, 0, robot.first_joint]), Rotation.identity()
    for link, joint in robot.links:
        for hinge in joint.hinges:
            turn = turn * Rotation.from_euler(hinge.axis, left.pop(0))
        found.append((place, turn))
        place = place + turn.apply([0, 0, link.length])
    return found


def straight(robot: Robot, num: int = 1, travel: float = 0.0) -> Snapshot:
    """Return robots at rest and straight, all sliders at one travel; positive: all cables are
    slack."""
    position = np.zeros((num, 7 + robot.num_cables + robot.num_hinges))
    position[:, 3] = 1
    position[:, 7 : 7 + robot.num_cables] = travel
    return at(robot, position, np.zeros((num, robot.num_coordinates)))


def moving(robot: Robot, num: int, bend: float = 0.3, seed: int = 0) -> Snapshot:
    """Return turned, bent robots with every coordinate in motion; cables are slack, taut or too
    long."""
    rng, cables, hinges = np.random.default_rng(seed), robot.num_cables, robot.num_hinges
    turn = Rotation.random(num, rng=rng).as_quat(scalar_first=True)
    place = [rng.uniform(-1, 1, (num, 3)), turn, rng.uniform(-0.05, 0.05, (num, cables))]
    position = np.concatenate([*place, rng.uniform(-bend, bend, (num, hinges))], axis=1)
    return at(robot, position, rng.uniform(-1, 1, (num, robot.num_coordinates)))


def slack(robot: Robot, simulation: Simulation) -> Array:
    """Return how much shorter than at rest each cable is, shape (num, C), in [m]; negative: too
    long."""
    state, route = simulation.state(), routing(robot)
    return route.rest_length - cable_lengths(route, state.cable_travel, state.joint_angles)


def stretch(simulation: Simulation, tension: float) -> float:
    """Return how much longer than at rest a cable may be under a tension in [N], in [m].

    Soft cables are MuJoCo's limits at its default softness. By its documentation ("Solver
    parameters") a limit that is exceeded by x gives, at rest, the force

        T = k x d / ((1 - d) A),  k = d / (dmax² t²),  so  x = T A (1 - d) (dmax t / d)²,

    where t = 0.02 s is its time constant, A the inverse inertia of the straight robot along the
    tendon, L M^-1 L^T, and d the impedance: dmax = 0.95 where x is over 1 mm, and from 0.9 below.
    """
    if "soft_cables" not in simulation.capabilities:
        return STRETCH
    with running(simulation.robot, simulation.engine) as still:
        equation = still.dynamics()
    L, M = equation.cable_jacobian[0], equation.mass_matrix[0]
    largest = tension * np.diagonal(L @ np.linalg.solve(M, L.T)).max() * 0.02**2
    return STRETCH + max(largest * (1 - 0.95), min(largest * (1 - 0.9) * (0.95 / 0.9) ** 2, 1e-3))


def momentum(simulation: Simulation) -> tuple[Array, Array, Array]:
    """Return the linear momentum in [kg m/s], the angular momentum about the centre of mass in
    [kg m²/s], and that centre in [m], each of shape (num, 3)."""
    equation = simulation.dynamics()
    mass, velocity = equation.mass_matrix, equation.velocity[..., None]
    linear, about_base = (mass[:, :3] @ velocity)[..., 0], (mass[:, 3:6] @ velocity)[..., 0]
    # The angular momentum of a unit translation is (first moment) x (direction).
    center = np.stack([mass[:, 5, 1], mass[:, 3, 2], mass[:, 4, 0]], axis=1) / mass[:, :1, 0]
    return linear, about_base - np.cross(center, linear), simulation.state().base_position + center


def energy(robot: Robot, simulation: Simulation, command: Array) -> Array:
    """Return the energy of motion, hinge springs, elastic cables, and servos as springs to their
    set-points, shape (num,), in [J]."""
    equation, state = simulation.dynamics(), simulation.state()
    kinetic = 0.5 * np.einsum(
        "ni,nij,nj->n", equation.velocity, equation.mass_matrix, equation.velocity
    )
    stiffness = np.array([hinge.stiffness for hinge in robot.hinges])
    gain = np.array([servo.gain for servo in robot.servos])
    springs = 0.5 * state.joint_angles**2 @ stiffness
    springs += 0.5 * np.minimum(slack(robot, simulation), 0) ** 2 @ elastic_stiffness(robot)
    return kinetic + springs + 0.5 * (state.cable_travel - command) ** 2 @ gain


def elastic_stiffness(robot: Robot) -> Array:
    """Return the stiffness of each cable as a spring, E A over its length along the straight arm,
    shape (C,), in [N/m]; zero for one that does not stretch."""
    found, arm = [], robot.first_joint - robot.top
    for segment in robot.segments:
        arm += sum(link.length for link, _ in segment.pairs)
        for _ in segment.cable_angles:
            length = segment.servo.offset + arm
            found.append((segment.cables.axial_stiffness or 0.0) / length)
    return np.array(found)


def random_parameters(robot: Robot, num: int, seed: int = 0) -> Parameters:
    """Return parameters that differ for every part of every copy."""
    random = np.random.default_rng(seed)

    def factors(parts: int) -> Array:
        return random.uniform(0.7, 1.4, (num, parts))

    return Parameters(
        base_mass=factors(1)[:, 0],
        base_inertia=factors(1),
        link_mass=factors(robot.num_links),
        link_inertia=factors(robot.num_links),
        joint_stiffness=factors(robot.num_links),
        joint_damping=factors(robot.num_links),
        slider_damping=factors(robot.num_cables),
        servo_gain=factors(robot.num_cables),
        rest_length_offset=random.uniform(-0.002, 0.002, (num, robot.num_cables)),
    )


def assert_same(
    found: State | Dynamics | Snapshot,
    expected: State | Dynamics | Snapshot,
    copies: slice | list[int] = slice(None),
    rtol: float = 0.0,
    atol: float = 0.0,
) -> None:
    """Compare all arrays of some copies; of snapshots only time, position and velocity."""
    common = ("time", "position", "velocity")
    for name in common if isinstance(found, Snapshot) else [field.name for field in fields(found)]:
        one, other = getattr(found, name)[copies], getattr(expected, name)[copies]
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol, err_msg=name)
