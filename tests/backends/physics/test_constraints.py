"""Cables pull and never push, only when taut, hardly stretch, and pass all work on from the sliders
to the joints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import nnls

from backends.contract_suite.states import (
    STRETCH,
    at,
    commands_of,
    moving,
    running,
    stretch,
)
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array, Dynamics, Simulation, State
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed, slack, with_parts
from training.measure.trajectories import demonstrator_commands

PULL = 250.0
"""No servo pulls harder, in [N]."""


def pulled(robot: Robot, simulation: Simulation, seconds: float) -> Iterator[tuple[State, Array]]:
    """Pull in each copy the cable of its number in full; yield the state and the slack of every
    step."""
    command = -np.diag([servo.eta for servo in robot.servos])
    for _ in range(round(seconds / robot.time_step)):
        simulation.step(command)
        yield simulation.state(), slack(robot, simulation)


def test_cables_pull_only_when_taut_and_hardly_stretch(robot: Robot, engine: str) -> None:
    """No engine has tension in a step that a cable begins and ends slack, but for the curvature of
    the motion, which opens a gap of about a micrometre under 240 N."""
    most = 0.0
    with running(robot, engine, robot.num_cables) as simulation:
        before = slack(robot, simulation)
        for state, after in pulled(robot, simulation, 0.4):
            assert state.cable_tension.min() >= 0
            assert (state.cable_tension * np.minimum(before, after).clip(0)).max() < 1e-3  # [N m]
            most, before = max(most, -after.min()), after
        assert np.diagonal(simulation.state().cable_tension).min() > 200
        assert most <= stretch(simulation, PULL)


def test_cables_hardly_stretch_along_demonstrations(robot: Robot, stiff_engine: str) -> None:
    """On the way to targets they get at most 0.05 mm longer than at rest."""
    commands, longest = demonstrator_commands(robot, stiff_engine, episodes=2, seed=1), 0.0
    with running(robot, stiff_engine, 2) as simulation:
        for each in commands.values.swapaxes(0, 1):
            simulation.step(each)
            longest = max(longest, -slack(robot, simulation).min())
    assert longest <= 0.05e-3


def test_a_moving_robot_does_not_stretch_its_cables(robot: Robot, stiff_engine: str) -> None:
    """Full commands jump every few steps, so that cables go slack and are torn taut by sliders and
    arm.

    Unhindered, sliders would move 6 mm too far in a step.
    """
    torn, most, copies = 0, 0.0, 8
    eta = np.array([servo.eta for servo in robot.servos])
    jumps = np.random.default_rng(0).random((15, copies, robot.num_cables)) < 0.4
    with running(robot, stiff_engine, copies) as simulation:
        before = slack(robot, simulation)
        for command in np.repeat(-eta * jumps, 7, axis=0):
            simulation.step(command)
            after, tension = slack(robot, simulation), simulation.state().cable_tension
            torn += ((before > 1e-4) & (tension > 0)).sum()
            most, before = max(most, -after.min()), after
    assert torn > 20
    assert most <= STRETCH


@pytest.mark.parametrize("room", ["a short offset", "short cables"])
def test_a_slider_stops_at_its_guide(engine: str, room: str) -> None:
    """A cable that is paid out to its end holds the arm.

    One cable pulls in full, and the arm pays the opposite one out. Past the guide a cable would get
    longer again where the equations of a step take it to get shorter: here by 294 mm.
    """
    robot = load_robot("planar-single")
    robot = with_parts(robot, servo={"offset": 0.05} if room == "a short offset" else {})
    short = 0.0 if room == "a short offset" else -0.15
    eta, below, radius = robot.servos[0].eta, robot.servos[0].offset, robot.servos[0].radius
    highest, most = -1.0, 0.0
    with running(robot, engine, robot.num_cables) as simulation:
        simulation.set_parameters(None, Parameters(rest_length_offset=short))
        simulation.reset()
        for _ in range(200):
            simulation.step(-eta * np.eye(robot.num_cables))
            highest = max(highest, simulation.state().cable_travel.max() - below)
            most = max(most, (-slack(robot, simulation) - short).max())
    assert -1.01 * radius < highest < -0.9 * radius
    if "soft_cables" not in simulation.capabilities:
        assert most < 5e-5


def test_a_slider_comes_to_rest_at_its_guide(engine: str) -> None:
    """Set-points past the guide push a slider, and no cable pulls it; Bullet lets it bounce."""
    robot = load_robot("planar-single")
    with running(robot, engine) as simulation:
        simulation.step(np.full((1, robot.num_cables), 5.0), 1000)
        state = simulation.state()
    stop = robot.servos[0].offset - robot.servos[0].radius
    np.testing.assert_allclose(state.cable_travel, stop, atol=1e-3)
    assert state.cable_tension.max() < 1e-6


def test_cables_pass_on_all_the_work(robot: Robot, stiff_engine: str) -> None:
    """The work that tensions take from the sliders is the work that they do on the joints.

    The work on the joints in a step is the tension times the fall of the length without the
    slider's part, from the difference of two lengths. The two may differ by the work of stretching,
    250 N times a millionth of a metre, of 4 to 14 J.
    """
    route, still = routing(robot), np.zeros((robot.num_cables, robot.num_cables))
    taken, done = np.zeros_like(still), np.zeros_like(still)
    with running(robot, stiff_engine, robot.num_cables) as simulation:
        last = simulation.state()
        for state, _ in pulled(robot, simulation, 0.3):
            pulled_in = last.cable_travel - state.cable_travel  # a pull is a negative travel
            taken += state.cable_tension * pulled_in
            lengths = [cable_lengths(route, still, each.joint_angles) for each in (last, state)]
            done += state.cable_tension * (lengths[0] - lengths[1])
            last = state
    stretching = PULL * 1e-6
    np.testing.assert_allclose(done.diagonal(), taken.diagonal(), rtol=0, atol=stretching)
    assert taken.diagonal().min() > 100 * stretching


def test_the_tensions_reported_are_those_that_act(robot: Robot, engine: str) -> None:
    """M qdd + bias = passive + servos - L^T tensions holds in a short step from moving states with
    taut cables.

    The rows of the base show that no tension pushes it. The damping is C v before or after the
    step; in one of 1e-6 s this makes no more difference than h c / m = 1e-4 for a slider.
    """
    robot, cables, copies = changed(robot, time_step=1e-6), robot.num_cables, 4
    start = moving(robot, copies, bend=0.1)
    command = commands_of(robot, 1, copies)[0]
    with running(robot, engine, copies) as simulation:
        simulation.set_snapshot(start)
        before = simulation.dynamics()
        simulation.step(command)
        tension = simulation.state().cable_tension
        acceleration = (simulation.dynamics().velocity - before.velocity) / robot.time_step
    assert (tension > 1).sum() >= 3
    force = before.passive_force - before.bias_force
    gain = np.array([servo.gain for servo in robot.servos])
    force[:, 6 : 6 + cables] += gain * (command - start.position[:, 7 : 7 + cables])
    force -= np.einsum("nci,nc->ni", before.cable_jacobian, tension)
    expected = np.linalg.solve(before.mass_matrix, force[..., None])[..., 0]
    np.testing.assert_allclose(acceleration, expected, atol=3e-4 * np.abs(expected).max())


def variants() -> dict[str, Robot]:
    """Return robots that have between them all that a step depends on but friction of guides."""
    paper, coupled = load_robot("paper"), load_robot("paper-coupled")
    tilted = {"position": (1.0, 2.0, 3.0), "quaternion": (0.6, 0.0, 0.8, 0.0)}
    fixed = paper.model_dump()["base"] | tilted | {"mount": "fixed"}
    pulls = {"kind": "tension", "gain": None, "eta": None, "largest_tension": 250.0}
    lower, upper = paper.model_dump()["segments"]
    helix = {"angle_deg": 10.0, "end_pitch_radius": 0.01, "twist_deg": 200.0}
    led = {"angle_deg": 130.0, "first_link": 2, "last_link": 5, "twist_deg": -50.0}
    ways = lower["cables"] | {"angles_deg": (10.0, 130.0), "paths": (helix, led)}
    torsion = {"stiffness": 1.0, "damping": 0.1, "limit": 0.9}
    twisting = lower["joint"] | {"order": "yx", "torsion": torsion, "rest": (0.1, -0.2)}
    held = {"pretension": 3.0, "force_limit": 12.0}
    curved = lower | {"joint": twisting, "cables": ways, "servo": lower["servo"] | held}
    stopped = {"joint": {"limit": 0.2}}
    return {
        "plain": paper,
        "coupled": changed(coupled, gravity=(1.0, -2.0, -9.0)),
        "elastic": with_parts(changed(paper, base=fixed), cables={"axial_stiffness": 3e3}),
        "tension": with_parts(load_robot("planar-single"), servo=pulls | {"force_limit": 200.0}),
        "curved": changed(paper, segments=[curved, upper], gravity=(0.0, 3.0, 0.0)),
        "damped": with_parts(paper, joint={"damping": 2.0}, servo={"damping": 60.0}),
        "stopped": with_parts(paper, **stopped),
        "stopped-coupled": with_parts(coupled, **stopped),
    }


def by_hand(
    robot: Robot, equation: Dynamics, joints: Array, command: Array, longer: Array, implicit: Array
) -> tuple[Array, Array]:
    """Return tensions and velocity after a step h of one copy: (M + h C) a = f - L' t, where no
    cable ends the step longer than at rest, but elastic ones by c t. What is longer already gets
    shorter with the recovery time; a joint past its limit takes back a fifth in a step, which is
    Bullet's default. Non-negative least squares finds t: with G G' = A and G y = b it minimizes
    |G' t - y|, so 0 <= t complementary to A t >= b.

    Args:
        robot: the description.
        equation: at the start of the step.
        joints: sliders and hinges, shape (C + H,).
        command: shape (C,).
        longer: is added to the rest lengths, shape (C,), in [m].
        implicit: C of the dampers that are implicit, shape (C + H,).
    """
    step, cables, free = robot.time_step, robot.num_cables, np.eye(robot.num_coordinates)
    travel, rows = joints[:cables], equation.cable_jacobian[0]
    for hinge, leader in enumerate(robot.leaders):  # columns of hinges that move alike are added
        free[6 + cables + hinge] = np.eye(len(free))[6 + cables + leader]
    free = free[:, free.any(axis=0)]
    if robot.base.mount == "fixed":
        free = free[:, 6:]
    force = equation.passive_force[0] - equation.bias_force[0]
    for c, servo in enumerate(robot.servos):
        pull = servo.gain * (servo.sign * command[c] - (servo.stiffness > 0) * travel[c])
        most = np.inf if servo.force_limit is None else servo.force_limit
        force[6 + c] += np.clip(pull - servo.pretension, -most, most)
    heavy = equation.mass_matrix[0] + np.diag(np.r_[np.zeros(6), step * implicit])
    mass = free.T @ heavy @ free
    gap = routing(robot).rest_length + longer - equation.cable_length[0]
    soft = np.array(robot.strain_by_tension) * (routing(robot).rest_length + longer)
    slow = (gap < 0) & (soft == 0)
    room = (gap / np.where(slow, robot.constraint.recovery_time, step)).tolist()
    upper = [servo.stop for servo in robot.servos] + [hinge.upper for hinge in robot.hinges]
    lower = [-np.inf] * cables + [hinge.lower for hinge in robot.hinges]
    for k in np.flatnonzero((joints < lower) | (joints > upper)):
        if k < cables or robot.leaders[k - cables] == k - cables:
            side, room = np.sign(joints[k]), [*room, -0.2 * (abs(joints[k]) - upper[k]) / step]
            rows = np.vstack([rows, side * np.eye(robot.num_coordinates)[6 + k]])
    pushed = rows @ free
    idle, across = np.linalg.solve(mass, free.T @ force), np.linalg.solve(mass, pushed.T)
    softness = np.r_[soft / step**2, np.zeros(len(rows) - cables)]
    wanted = (rows @ equation.velocity[0] + step * pushed @ idle - room) / step
    root = np.linalg.cholesky(pushed @ across + np.diag(softness))
    force, _ = nnls(root.T, np.linalg.solve(root, wanted), maxiter=1000)
    return force[:cables], equation.velocity[0] + step * free @ (idle - across @ force)


LIMITS = ("stopped", "stopped-coupled")
"""Robots whose joints pass their limits, which are soft in MuJoCo."""


@pytest.mark.parametrize(
    ("engine", "name"),
    [("pybullet", name) for name in variants()]
    + [("mujoco", name) for name in variants() if name not in LIMITS],
)
def test_a_step_is_the_solution_of_its_conditions(engine: str, name: str) -> None:
    """Tensions and velocities are those of non-negative least squares, step after step, with slack,
    taut and too long cables, and servos at their limits. Constraints of MuJoCo have an impedance
    of 0.9999, so that they are a little soft. Its dampers are implicit; in PyBullet those of joints
    that twist are, and those that are too stiff for the bodies at them: not at the heavy base."""
    robot, random, pulling = variants()[name], np.random.default_rng(3), 0
    start, cables = moving(robot, 1, bend=0.23 if name in LIMITS else 0.2), robot.num_cables
    leaders, exact = list(robot.leaders), 1e-5 if engine == "pybullet" else 5e-3
    for part, before in ((start.position, 7), (start.velocity, 6)):
        part[:, before + cables :] = part[:, before + cables :][:, leaders]
    start.position[:, 7 : 7 + cables] += 0.02
    longer = random.uniform(-2e-3, 2e-3, cables)
    if robot.base.mount == "fixed":
        start.velocity[:, :6] = 0
    damping = [part.damping for part in (*robot.servos, *robot.hinges)]
    implicit = np.array(damping) * (engine == "mujoco" or name in ("curved", "damped"))
    implicit[cables : cables + 2] *= not (engine == "pybullet" and name == "damped")
    with running(robot, engine) as simulation:
        simulation.set_parameters(None, Parameters(rest_length_offset=longer[None]))
        simulation.set_snapshot(at(robot, start.position, start.velocity))
        for command in commands_of(robot, 25, 1, hold=3)[:, 0]:
            equation, joints = simulation.dynamics(), simulation.get_snapshot().position[0, 7:]
            tension, velocity = by_hand(robot, equation, joints, command, longer, implicit)
            simulation.step(command[None])
            after = simulation.get_snapshot().velocity[0], simulation.state().cable_tension[0]
            for found, expected in zip(after, (velocity, tension), strict=True):
                most = exact * np.abs(expected).max()
                np.testing.assert_allclose(found, expected, rtol=0, atol=most)
            pulling += np.count_nonzero(tension)
    assert 0.05 < pulling / 25 / cables < 0.95
