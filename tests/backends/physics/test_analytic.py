"""Motions with a closed form: one link that swings on the free base, and sliders on their
servos."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from backends.contract_suite.states import at, running, straight
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array
from tests.support.physics import changed


def one_link(joint_damping: float = 0.0, servo_damping: float = 20.0, divide: int = 1) -> Robot:
    """Return one link on a base of 8 kg, which gives way by a lot, differently about x and y."""
    robot = load_robot("planar-single")
    segment = robot.model_dump()["segments"][0]
    parts = {
        "joint": segment["joint"] | {"damping": joint_damping},
        "servo": segment["servo"] | {"damping": servo_damping},
    }
    base = robot.base.model_dump() | {"mass": 8.0, "inertia": (0.3, 0.5, 0.6)}
    return changed(
        robot,
        time_step=robot.time_step / divide,
        base=base,
        segments=[segment | {"links": 1} | parts],
    )


def swinging_inertia(robot: Robot, axis: int) -> float:
    """Return the moment of inertia in [kg m²] that one hinge feels near the straight pose, while
    the free base gives way.

    In the plane across the hinge, the base with its sliders moves sideways by s and turns by f
    about its centre, and the link turns by f + q. The speeds of the centres of mass are s' for the
    base, s' + z f' for a slider at height z, and s' + (t + a) f' + a q' for the link; its middle is
    at height a above the joint, which is at t above the base's centre. With the momenta of s and f
    zero, what is left of the kinetic energy is 1/2 I q'².
    """
    base, servo = robot.base, robot.segments[0].servo
    link, cables = robot.segments[0].link, robot.segments[0].cables
    a, t = link.length / 2, base.size[2] / 2
    energy = np.zeros((3, 3))  # the quadratic form of (s', f', q')

    def body(
        mass: float,
        moment: float,
        sideways: tuple[float, float, float],
        turn: tuple[float, float, float],
    ) -> None:
        nonlocal energy
        energy = energy + mass * np.outer(sideways, sideways) + moment * np.outer(turn, turn)

    body(base.mass, base.inertia[axis], (1, 0, 0), (0, 1, 0))
    for angle in np.deg2rad(cables.angles_deg):
        z = t - cables.guide_offset - servo.offset + 0.05  # paid out by 0.05 m
        beside = cables.pitch_radius * (np.cos(angle) if axis == 1 else np.sin(angle))
        ball = 2 / 5 * servo.mass * servo.radius**2
        body(servo.mass, ball + servo.mass * beside**2, (1, z, 0), (0, 1, 0))
    body(link.mass, link.inertia[axis], (1, t + a, a), (0, 1, 1))
    free, mixed = energy[:2, :2], energy[:2, 2]
    return float(energy[2, 2] - mixed @ np.linalg.solve(free, mixed))


def poles(samples: Array, interval: float) -> complex:
    """Return the pole -damping + i frequency, in [rad/s], of a decaying cosine sampled at equal
    intervals.

    Such samples obey q[n + 2] = b q[n + 1] - c q[n] exactly (Prony's method); b and c are found by
    least squares.
    """
    (b, c), *_ = np.linalg.lstsq(
        np.column_stack([samples[1:-1], -samples[:-2]]), samples[2:], rcond=None
    )
    root = (b + np.sqrt(complex(b * b - 4 * c))) / 2
    return np.log(root) / interval


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_link_swings_with_the_closed_forms_frequency_and_damping(
    undamped_engine: str, axis: int, damping: float
) -> None:
    """The frequency is sqrt(k / I) and the damping ratio c / (2 sqrt(k I)), recoil of the base
    included.

    Measured with h w = 0.0025: the frequency is within 7e-5, the damping ratio within 5e-5.
    """
    robot = one_link(joint_damping=damping, divide=10)
    start, cables = straight(robot, travel=0.05), robot.num_cables
    start.position[0, 7 + cables + axis] = 0.01
    inertia, stiffness = swinging_inertia(robot, axis), robot.segments[0].joint.stiffness
    on_a_fixed_base = robot.segments[0].link.inertia[axis] + 1.18 * 0.1**2
    assert inertia < 0.9 * on_a_fixed_base  # the base does give way
    frequency, ratio = np.sqrt(stiffness / inertia), damping / (2 * np.sqrt(stiffness * inertia))
    angles = []
    with running(robot, undamped_engine) as simulation:
        simulation.set_snapshot(at(robot, start.position, start.velocity))
        for _ in range(150):
            angles.append(simulation.state().joint_angles[0, axis])
            simulation.step(np.full((1, cables), 0.05), 40)
        assert np.abs(simulation.state().joint_angles[0, 1 - axis]) < 1e-6
        assert not simulation.state().cable_tension.any()
    found = poles(np.array(angles), 40 * robot.time_step)
    assert abs(found) == pytest.approx(frequency, rel=2e-4)
    assert -found.real / abs(found) == pytest.approx(ratio, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("damping", [1.0, 20.0])
def test_sliders_of_slack_cables_answer_a_step_like_mass_spring_damper(
    undamped_engine: str, damping: float
) -> None:
    """All sliders move together from 0.08 m to a set-point of 0.05 m; below 0 their cables would
    pull.

    Each of the n sliders of mass m swings against the rest of the robot of mass R, which gives way,
    so that its mass counts as m R / (R + n m). The damping ratio is 0.16 in one case, and 3.2 as
    shipped in the other. The error is of first order in the step.
    """
    errors = []
    for divide in (1, 4):
        robot = one_link(servo_damping=damping, divide=divide)
        servo, num = robot.servos[0], robot.num_cables
        rest = robot.total_mass - num * servo.mass
        mass = servo.mass * rest / (rest + num * servo.mass)
        assert mass < 0.95 * servo.mass
        onward = expm(
            divide
            * robot.time_step
            * np.array([[0, 1], [-servo.gain / mass, -servo.damping / mass]])
        )
        start, worst = straight(robot, travel=0.08), 0.0
        with running(robot, undamped_engine) as simulation:
            simulation.set_snapshot(start)
            expected = np.array([0.03, 0.0])  # travel above the set-point, and its rate
            for _ in range(200):
                simulation.step(np.full((1, num), 0.05), divide)
                expected = onward @ expected
                worst = max(
                    worst, np.abs(simulation.state().cable_travel - 0.05 - expected[0]).max()
                )
            assert not simulation.state().cable_tension.any()
        errors.append(worst / 0.03)
    assert errors[0] < 0.03
    assert errors[1] < 0.3 * errors[0]
