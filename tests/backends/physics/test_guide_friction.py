"""Cables that rub in their guides follow the capstan law, stick, and only take energy."""

from __future__ import annotations

import numpy as np
import pytest

from backends.contract_suite.states import commands_of, running, straight
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.capstan import Capstan
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from tests.backends.physics.test_servos import TENSION
from tests.backends.physics.test_statics import settling
from tests.support.physics import changed, energy, momentum, walk, with_parts

MU = 0.2


def rough(robot: Robot, friction: float = MU, **servo: object) -> Robot:
    return with_parts(robot, cables={"guide_friction": friction}, servo=servo)


def arm(friction: float = MU) -> Robot:
    """Return a light, damped arm of one segment whose commands are tensions. Idle cables do not
    hold it: their sliders are free."""
    return rough(settling(load_robot("planar-single")), friction, **TENSION, damping=0.0)


def pulled(simulation: Simulation, start: float, end: float, steps: int = 1500) -> None:
    """Let the first cable's tension go from one number to another, in [N]."""
    for tension in np.linspace(start, end, steps + 1)[1:]:
        command = np.zeros((1, simulation.robot.num_cables))
        command[0, 0] = tension
        simulation.step(command)


def guides(robot: Robot, hinges: Array) -> Array:
    """Return the places that the first cable, which runs along the arm, passes: in the base below
    and in the first guide, then those of each link; shape (2 J + 2, 3), in [m]."""
    cables = robot.segments[0].cables
    o, angle = cables.guide_offset, np.deg2rad(cables.angles_deg[0])
    across = cables.pitch_radius * np.array([np.cos(angle), np.sin(angle)])
    points = [np.append(across, robot.first_joint - height) for height in (2 * o, o)]
    for (place, turn), (link, _) in zip(walk(robot, hinges), robot.links, strict=True):
        points += [place + turn @ np.append(across, z) for z in (o, link.length - o)]
    return np.array(points)


def tensions(robot: Robot, simulation: Simulation) -> tuple[Array, Array]:
    """Return the tension of the first cable behind each joint, by the torque of the joint's spring
    and damper and a numerical lever arm, in [N]; and by what angle the cable has turned up to
    there, in [rad]."""
    state = simulation.state()
    hinges, rates = state.joint_angles[0], state.joint_rates[0]
    along = np.diff(guides(robot, hinges), axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    turned = np.cumsum(np.arccos(np.clip((along[1:] * along[:-1]).sum(axis=1), -1, 1)))
    found = []
    for j, hinge in enumerate(robot.hinges):
        if hinge.axis == "y":  # about which the cable bends the arm
            step = 1e-6 * (np.arange(len(hinges)) == j)
            points = [guides(robot, hinges + sign * step) for sign in (1, -1)]
            lengths = [np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in points]
            arm = (lengths[0] - lengths[1]) / 2e-6
            found.append(-(hinge.stiffness * hinges[j] + hinge.damping * rates[j]) / arm)
    return np.array(found), turned[::2]


def test_a_sliding_cable_obeys_the_capstan_equation(stiff_engine: str) -> None:
    """Behind every guide ln(T0 / T) is mu times the angle that the cable has turned by: when it is
    pulled, and with the other sign once all of it slides back."""
    robot = arm()
    with running(robot, stiff_engine) as simulation:
        for sign, (start, end) in {1: (0, 40), -1: (40, 14)}.items():
            pulled(simulation, start, end)
            found, turned = tensions(robot, simulation)
            before = simulation.state().cable_tension[0, 0]
            assert turned[-1] > 0.8
            np.testing.assert_allclose(np.log(before / found), sign * MU * turned, atol=3e-3)


def test_a_cable_sticks_until_the_tension_has_fallen_twice_as_far(stiff_engine: str) -> None:
    """After a pull T0 the last tension is T0 exp(-mu a); it stays until T0 is that times
    exp(-mu a)."""
    robot = arm(0.4)
    with running(robot, stiff_engine) as simulation:
        pulled(simulation, 0, 40, 500)
        simulation.step(np.array([[40.0, 0, 0, 0]]), 200)
        angles = [simulation.state().joint_angles[0]]
        _, turned = tensions(robot, simulation)
        limit = 40 * np.exp(-2 * 0.4 * turned[-1])
        last = 40.0
        for tension in (1.2 * limit, 0.7 * limit):
            pulled(simulation, last, tension, 400)
            last = tension
            angles.append(simulation.state().joint_angles[0])
    bent = np.abs(angles[0]).max()
    outermost = np.argmax(np.abs(angles[0][-2:])) - 2
    assert abs(angles[1][outermost] - angles[0][outermost]) < 1e-2 * bent
    assert abs(angles[2][outermost] - angles[0][outermost]) > 5e-2 * bent


def test_friction_only_takes_energy_and_no_momentum(stiff_engine: str) -> None:
    """A bent arm swings in space without dampers, its cables held by the servos' springs. Without
    friction it keeps its energy."""
    undamped = with_parts(load_robot("paper"), joint={"damping": 0.0}, servo={"damping": 0.0})
    command, falls, turns = np.full((1, undamped.num_cables), -0.2), [], []
    command[0, ::4] = -3.0
    for friction in (MU, 0.0):
        robot = changed(rough(undamped, friction), time_step=5e-4)
        with running(robot, stiff_engine) as simulation:
            left = []
            for _ in range(20):
                simulation.step(command, 20)
                left.append(float(energy(robot, simulation, command)[0]))
            linear, angular, _ = momentum(simulation)
            assert np.abs(simulation.state().joint_rates).max() > 0.5
        falls.append(np.diff(left))
        turns.append(np.abs([linear, angular]).max())
    rubbed, kept = falls
    assert turns[0] < 1.5 * turns[1]  # what is there is the integrator's
    assert rubbed.max() < 0
    assert np.abs(kept).sum() < 0.1 * np.abs(rubbed).sum()


def test_a_bending_arm_rubs_by_a_half_to_the_whole_of_the_capstans_part() -> None:
    """A cable that slides over an angle a in all loses the part 1 - exp(-mu a) of its tension; one
    that sticks in some guides loses less. PyBullet's snapshot holds the friction of each place."""
    robot, command = rough(load_robot("planar-single")), np.array([[-5.0, 0.0, 0.0, -2.0]])
    first, most = np.array(Capstan(robot).cable) == 0, 0.0
    with running(robot, "pybullet") as simulation:
        for _ in range(3):
            simulation.step(command, 20)
            state, snapshot = simulation.state(), simulation.get_snapshot()
            along = np.diff(guides(robot, state.joint_angles[0]), axis=0)
            along /= np.linalg.norm(along, axis=1)[:, None]
            turned = np.arccos(np.clip((along[1:] * along[:-1]).sum(1), -1, 1)).sum()
            most = state.cable_tension[0, 0] * (1 - np.exp(-MU * turned))
            assert 0.5 * most < snapshot.private[0, robot.num_cables :][first].sum() < most
    assert most > 20


def test_both_engines_rub_alike() -> None:
    """MuJoCo's dry friction of tendons and our rows for Bullet have the bounds in common, and
    nothing else. Under random pulls the tips stay together as far as the engines' steps allow, and
    far from where they were without friction."""
    smooth = changed(load_robot("planar-single"), time_step=5e-4)
    commands, tips = commands_of(smooth, 600, hold=200), {}
    for name, robot in (("rough", rough(smooth)), ("smooth", smooth)):
        for engine in ("mujoco", "pybullet"):
            with running(robot, engine) as simulation:
                found = []
                for command in commands[::10]:
                    simulation.step(command, 10)
                    found.append(simulation.state().tip_position[0])
                tips[name, engine] = np.array(found)

    def apart(one: tuple[str, str], other: tuple[str, str]) -> float:
        return float(np.linalg.norm(tips[one] - tips[other], axis=1).max())

    assert apart(("rough", "mujoco"), ("smooth", "mujoco")) > 0.015
    assert apart(("rough", "mujoco"), ("rough", "pybullet")) < 2e-3


def test_the_plant_makes_guides_rough_and_smooth(stiff_engine: str) -> None:
    """`guide_friction` adds to the description's; copies have their own, a snapshot carries on."""
    smooth = load_robot("planar-single")
    plants = {
        "smooth": (smooth, 0.0),
        "rough": (rough(smooth), 0.0),
        "added": (smooth, [0, MU]),
        "taken off": (rough(smooth), [-MU, 0]),
    }
    ends = {}
    for name, (robot, friction) in plants.items():
        with running(robot, stiff_engine, 2) as simulation:
            simulation.set_parameters(None, Parameters(guide_friction=friction))
            simulation.set_snapshot(straight(robot, 2))
            commands = commands_of(robot, 80, hold=80)[:, [0, 0]]
            for command in commands[:40]:
                simulation.step(command)
            with running(robot, stiff_engine, 2) as other:
                other.set_parameters(None, Parameters(guide_friction=friction))
                other.set_snapshot(simulation.get_snapshot())
                for command in commands[40:]:
                    simulation.step(command)
                    other.step(command)
                ends[name] = simulation.state().tip_position
                np.testing.assert_allclose(other.state().tip_position, ends[name], atol=1e-9)
    apart = float(np.linalg.norm(ends["rough"][0] - ends["smooth"][0]))
    assert apart > 1e-2
    for name in ("added", "taken off"):
        expected = [ends["smooth"][0], ends["rough"][0]]
        np.testing.assert_allclose(ends[name], expected, rtol=0, atol=1e-4 * apart)


def test_a_cable_without_a_guide_that_rubs_is_smooth(stiff_engine: str) -> None:
    """It runs through a sheath to its only joint, so there is no guide before a joint."""
    path = {"angle_deg": 20.0, "first_link": 1, "last_link": 1}
    bare = with_parts(load_robot("planar-single"), cables={"paths": [path], "angles_deg": [20.0]})
    ends = []
    for robot in (bare, rough(bare)):
        with running(robot, stiff_engine) as simulation:
            simulation.set_parameters(None, Parameters(link_mass=1.5))
            simulation.step(np.array([[-0.1]]), 40)
            ends.append(simulation.state().tip_position)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)


def test_friction_that_cannot_be_is_refused() -> None:
    with pytest.raises(CdcsrError, match="mujoco-stock has no friction in guides"):
        make_simulation(arm(), "mujoco-stock")
    with pytest.raises(CdcsrError, match=r"must be at least -0\.2, where nothing rubs"):
        Parameters(guide_friction=-0.3).plant(arm(), 1)
    with pytest.raises(ValueError, match="less than or equal to 2"):
        rough(load_robot("paper"), 3.0)
