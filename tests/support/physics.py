"""Helpers for tests of physics: changed robots, states, commands, and conserved quantities.

They know no engine and measure everything through the contract.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array, Simulation


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


def walk(robot: Robot, hinges: Array) -> list[tuple[Array, Array]]:
    """Return the place of each link's joint in [m], and how the link is turned, as a matrix, in the
    base's frame at hinge angles of shape (H,); walks out along the arm."""
    found, links = [], robot.links
    axes = np.array([np.eye(3)["xyz".index(h.axis)] for _, joint in links for h in joint.hinges])
    bends = iter(Rotation.from_rotvec(axes * np.asarray(hinges)[:, None]).as_matrix())
    place, turn = np.array([0, 0, robot.first_joint]), np.eye(3)
    for link, joint in links:
        for _ in joint.hinges:
            turn = turn @ next(bends)
        found.append((place, turn))
        place = place + turn @ [0, 0, link.length]
    return found


def slack(robot: Robot, simulation: Simulation) -> Array:
    """Return how much shorter than at rest each cable is, shape (num, C), in [m]; negative: too
    long."""
    state, route = simulation.state(), routing(robot)
    return route.rest_length - cable_lengths(route, state.cable_travel, state.joint_angles)


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
