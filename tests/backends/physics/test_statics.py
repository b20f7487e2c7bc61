"""The arm comes to rest where the potential energy is least, and in the textbook's arc.

Both are computed from the description alone, with the geometry of the guides built anew. The pose
at rest does not depend on masses or damping, so the links are light and the dampers such that the
arm settles soon.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import STRETCH, running, stretch
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, State
from tests.support.physics import changed, slack, walk, with_parts

HINGE = ("stiffness", "rest")
"""The numbers of a hinge on which its pose at rest depends."""


def swing(robot: Robot) -> float:
    """Estimate the lowest frequency of the straight arm on its hinge springs in series, in
    [rad/s]."""
    compliance = sum(1 / joint.stiffness for _, joint in robot.links)
    inertia = sum(link.mass for link, _ in robot.links) * robot.arm_length**2 / 3
    return float(np.sqrt(1 / compliance / inertia))


def settling(robot: Robot, weight: float = 1e-2) -> Robot:
    """Return the robot with lighter links, by default of 1 % of the mass, and with hinge dampers
    that soon end its swinging.

    The links are not lighter: MuJoCo computes the force of a limit with the mass matrix M and then
    moves with M + hC, so where hC is over 100 times M cables stretch by millimetres and chatter.
    """
    segments = []
    relaxation = 1.2 * np.sqrt(weight) / swing(robot)  # 0.6 of critical damping
    for segment in robot.model_dump()["segments"]:
        link, joint = segment["link"], segment["joint"]
        light = {
            "mass": link["mass"] * weight,
            "inertia": [moment * weight for moment in link["inertia"]],
        }
        damped = {"damping": relaxation * joint["stiffness"]}
        segments.append(segment | {"link": link | light, "joint": joint | damped})
    return changed(robot, segments=segments)


def at_rest(robot: Robot, engine: str, command: Array) -> tuple[State, float]:
    """Return the state after a long time under constant commands, and by how much a cable may be
    longer than at rest under the largest tension, in [m]; no cable is longer."""
    with running(robot, engine, len(command)) as simulation:
        simulation.step(command, round(18 / swing(robot) / robot.time_step))
        state = simulation.state()
        assert np.abs(state.joint_rates).max() < 1e-3
        allowed = stretch(simulation, state.cable_tension.max())
        assert slack(robot, simulation).min() > -allowed
        return state, allowed


def taken_in(robot: Robot, hinges: Array) -> Array:
    """Return how far each slider must rise for its cable to be at its rest length, shape (C,), in
    [m].

    This adds up the distances between the guides on both sides of each joint; the rest of a cable
    does not change its length.
    """
    walked = [np.eye(3), *(turn for _, turn in walk(robot, hinges))]
    turns = np.array([low.T @ high for low, high in pairwise(walked)])
    shortened, joints = [], 0
    for segment in robot.segments:
        joints += segment.links
        for angle in np.deg2rad(segment.cable_angles):
            cables = segment.cables
            x, y = cables.pitch_radius * np.cos(angle), cables.pitch_radius * np.sin(angle)
            above = turns[:joints] @ [x, y, cables.guide_offset]
            below = np.array([x, y, -cables.guide_offset])
            apart = np.linalg.norm(above - below, axis=1)
            shortened.append(np.sum(apart - 2 * cables.guide_offset))
    return np.array(shortened)


@cache
def least_energy(robot: Robot, command: tuple[float, ...]) -> Array:
    """Return the hinge angles of least potential energy, shape (2 J,), in [rad]; found once for all
    engines.

    The energy is 1/2 k q² of every hinge and 1/2 g (x - command)² of every servo, with every cable
    at most at its rest length. For given angles this means x >= taken_in(q), and the best x is the
    command or, if that is too low, the lowest possible. What remains is a sum of squares in q
    alone.
    """
    stiffness = np.array([joint.stiffness for _, joint in robot.links for _ in "xy"])
    gain = np.array([servo.gain for servo in robot.servos])

    def terms(hinges: Array) -> Array:
        stretch = np.maximum(taken_in(robot, hinges) - command, 0)
        return np.concatenate([np.sqrt(stiffness) * hinges, np.sqrt(gain) * stretch])

    found = least_squares(
        terms, np.zeros(robot.num_hinges), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-12
    )
    return found.x


def check_rest(robot: Robot, engine: str, num: int, seed: int) -> None:
    """Set-points are up to 0.4 m below rest and differ between cables: the arm bends in any plane,
    within the hinge limits."""
    command = np.random.default_rng(seed).uniform(-0.4, 0.0, (num, robot.num_cables))
    state, allowed = at_rest(settling(robot), engine, command)
    gain = np.array([servo.gain for servo in robot.servos])
    for copy, pulls in enumerate(command):
        expected = least_energy(robot, tuple(pulls))
        assert 0.02 < np.abs(expected).max() < 0.9 * robot.segments[0].joint.limit
        travel = np.maximum(taken_in(robot, expected), pulls)
        # A cable that stretches is a spring in series with that of its servo, whose tension, and
        # with it the pose, falls by the share of the stretch in the servo's error.
        longer = allowed - STRETCH
        share = longer / (state.cable_tension.max() / gain.max())
        off = 2e-4 + 2 * share * np.abs(expected).max()
        np.testing.assert_allclose(state.joint_angles[copy], expected, atol=off)
        np.testing.assert_allclose(state.cable_travel[copy], travel, atol=2e-5 + longer)
        np.testing.assert_allclose(
            state.cable_tension[copy], gain * (travel - pulls), atol=2e-3 + gain.max() * longer
        )


def hanging_arm() -> Robot:
    """Return an arm with a turned, fixed base under gravity: joints with torsion that rest bent,
    links that taper, three cables, a joint that bends in a plane, and a passive rod at the end that
    tapers and is curved at rest."""
    data = load_robot("planar-single").model_dump()
    twist = {"stiffness": 2.0, "damping": 1.0, "limit": 1.5, "rest": -0.1}
    bend = {"stiffness": 3.0, "damping": 1.5, "limit": 1.5, "order": "yx", "rest": (0.2, -0.1)}
    segment = {
        "links": 3,
        "link": {
            **{"length": 0.1, "radius": 0.02, "mass": 0.2, "center": 0.08},
            "inertia": (2e-3, 2e-3, 1e-3),
        },
        "taper": {"radius": 0.8, "mass": 0.7},
        "joint": bend | {"torsion": twist},
        "cables": {"angles_deg": (10, 130, 250), "pitch_radius": 0.03, "guide_offset": 0.01},
        "servo": data["segments"][0]["servo"] | {"gain": 400.0, "mass": 0.2},
    }
    rod = {
        **{"length": 0.3, "youngs_modulus": 5e7, "poissons_ratio": 0.3, "density": 4000.0},
        **{"radius": 0.011, "end_radius": 0.009, "damping_time": 0.3, "curvature": (1.0, -0.5)},
    }
    hinged = [segment["link"] | {"joint": bend | {"order": "x", "rest": (0.3,)}}]
    base = {"mount": "fixed", "position": (1.0, 2.0, 3.0), "quaternion": (0.5, 0.5, -0.5, 0.5)}
    return changed(
        load_robot("planar-single"),
        base=data["base"] | base,
        gravity=(1.0, -2.0, -9.0),
        segments=[segment, {"chain": hinged}, {"links": 3, "backbone": rod}],
        time_step=1e-3,
    )


@cache
def hanging_angles(command: tuple[float, ...]) -> Array:
    """Return the hinge angles at which that arm has the least potential energy, in [rad].

    The energy is that of springs and servos, and the height of every link's centre of mass times
    its weight; sliders weigh along their cables too.
    """
    robot = hanging_arm()
    fall = Rotation.from_quat(robot.base.quaternion, scalar_first=True).inv().apply(robot.gravity)
    stiffness, rest = (np.array([getattr(h, key) for h in robot.hinges]) for key in HINGE)
    at_start = taken_in(robot, rest)
    servo = robot.segments[0].servo
    sag = servo.mass * fall[2] / servo.gain

    def energy(hinges: Array) -> float:
        low = np.maximum(taken_in(robot, hinges) - at_start - command - sag, 0)
        total = 0.5 * stiffness @ (hinges - rest) ** 2 + 0.5 * servo.gain * low @ low
        for (link, _), (place, turn) in zip(robot.links, walk(robot, hinges), strict=True):
            total -= link.mass * fall @ (place + turn @ [0, 0, link.center_of_mass])
        return float(total)

    return minimize(energy, np.zeros(robot.num_hinges), method="BFGS", options={"gtol": 1e-9}).x


def test_a_hanging_arm_has_the_least_potential_energy(stiff_engine: str) -> None:
    robot, command = hanging_arm(), (-0.05, -0.05, -0.06)
    expected = hanging_angles(command)
    with running(robot, stiff_engine) as simulation:
        simulation.step(np.array([command]), 5000)
        state = simulation.state()
    assert np.abs(state.joint_rates).max() < 1e-4
    assert np.abs(expected).max() > 0.1
    assert (state.cable_tension[0] > 1).all()
    np.testing.assert_allclose(state.joint_angles[0], expected, atol=2e-5)


@pytest.mark.parametrize("name", ["planar-single", "paper"])
def test_a_settled_arm_has_the_least_potential_energy(name: str, engine: str) -> None:
    """Robots of one and of two segments; measured within 2e-6 rad and 2e-4 N in both engines."""
    check_rest(load_robot(name), engine, num=1, seed=0)


@pytest.mark.slow
def test_every_settled_arm_has_the_least_potential_energy(robot: Robot, engine: str) -> None:
    """More commands and all robots; measured within 6e-5 rad, the rest of the swinging."""
    check_rest(robot, engine, num=4, seed=1)


def test_a_settled_cable_at_full_command_keeps_its_length(engine: str) -> None:
    """A servo pulls with its full 250 N. The hinges are ten times as stiff, so that the arm does
    not reach its hinge limits."""
    robot = with_parts(load_robot("planar-single"), joint={"stiffness": 20.0})
    command = np.diag([-servo.eta for servo in robot.servos])[:1]
    state, _ = at_rest(settling(robot, weight=0.1), engine, command)
    assert state.cable_tension[0, 0] > 200


def chain_of(num: int) -> Robot:
    """Return one segment of 1.2 m in `num` links, bent by a cable 30 degrees from the x axis.

    With more links the hinges and their dampers are stiffer; each link has the moment of inertia
    that its damper needs (see `settling`), which does not change the pose at rest.
    """
    share, length = num / 6, 1.2 / num
    robot = settling(load_robot("planar-single"))
    segment = robot.model_dump()["segments"][0]
    joint = {key: segment["joint"][key] * share for key in ("stiffness", "damping")}
    moments = [2e-4 * share] * 3
    parts = {
        "links": num,
        "link": segment["link"] | {"length": length, "mass": 0.07, "inertia": moments},
        "joint": segment["joint"] | joint,
        "cables": {"angles_deg": [30, 150, 270], "pitch_radius": 0.02, "guide_offset": 0.01},
    }
    return changed(robot, segments=[segment | parts])


def test_many_short_links_bend_into_the_textbooks_arc(stiff_engine: str) -> None:
    """A cable taken in by d at radius r bends a constant-curvature segment by d / r, towards the
    cable.

    R. J. Webster III and B. A. Jones, "Design and kinematic modeling of constant curvature
    continuum robots: a review", Int. J. Robotics Research 29(13), 2010, pp. 1661-1683. The other
    cables are paid out. Straight links bend in steps, so the tip is off by a share of the length
    that falls as 1 / links.
    """
    off, bend = [], 0.0
    for num in (3, 6, 12):
        robot = chain_of(num)
        state, _ = at_rest(robot, stiff_engine, np.array([[-0.5, 0.1, 0.1]]))
        bend = -state.cable_travel[0, 0] / 0.02
        radius, direction = 1.2 / bend, np.deg2rad(30)
        across = radius * (1 - np.cos(bend))
        arc = [
            across * np.cos(direction),
            across * np.sin(direction),
            robot.top + radius * np.sin(bend),
        ]
        base = Rotation.from_quat(state.base_quaternion[0], scalar_first=True)
        tip = base.inv().apply(state.tip_position[0] - state.base_position[0])
        off.append(float(np.linalg.norm(tip - arc)))
    assert bend > 1
    assert off[2] < 0.06
    orders = np.log2(np.array(off[:-1]) / off[1:])
    assert ((orders > 0.8) & (orders < 1.3)).all()
