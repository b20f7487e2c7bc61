"""Elastic rods of links tend to what continuous ones do; loads, gravity and a fixed base act."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import Make
from backends.cosserat.equilibrium import _slope, equilibrium
from backends.parity.one_state import one_state
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.poses import arms
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import load_backend, make_simulation
from tests.support.physics import changed, momentum
from tests.support.rods import CABLES, elastica, rod_robot

LENGTH, STIFFNESS = 0.4, 0.0344  # [m], [N m^2]
TUBE = {
    "length": LENGTH,
    "youngs_modulus": STIFFNESS / (np.pi * 0.005**4 / 4),
    "poissons_ratio": 0.4,
    "density": 1200.0,
    "radius": 0.005,
    "damping_time": 0.05,
}


@pytest.fixture
def engine(undamped_engine: str) -> str:
    return undamped_engine


def tip_of(robot: Robot, engine: str, make: Make, **load: object) -> np.ndarray:
    """Return where the tip rests under a load on the last link, from the clamp, in [m]."""
    simulation = make(engine, robot)
    simulation.set_loads(None, -1, **load)  # pyright: ignore[reportArgumentType]
    equilibrium(simulation)
    return simulation.state().tip_position[0] - (0, 0, robot.top)


@pytest.mark.parametrize("links", [9, 10])
def test_a_rod_under_a_tip_force_is_the_elastica_to_second_order(
    links: int, engine: str, make: Make
) -> None:
    """A force of 1 N bends it by more than 1 rad, in a plane through neither axis. With N links the
    tip is off by about 26 L / (100 N^2)."""
    across, along = elastica(1.0, LENGTH, STIFFNESS)
    direction = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    off = []
    for count in (links, 2 * links, 4 * links):
        robot = rod_robot(count, TUBE)
        end = (0, 0, robot.links[-1][0].length)
        tip = tip_of(robot, engine, make, force=direction, point=end)
        off.append(np.linalg.norm(tip - (across * direction + [0, 0, along])))
    orders = np.log2(np.array(off[:-1]) / off[1:])
    assert np.abs(orders - 2).max() < 0.1
    assert across > 0.6 * LENGTH
    assert off[0] < 0.5 * LENGTH / links**2


def test_a_rod_under_a_torque_along_it_twists_by_t_l_over_g_j(engine: str, make: Make) -> None:
    """G J = E I / (1 + nu); joints twist as much as cells do, so this holds for any number."""
    robot = rod_robot(7, TUBE)
    simulation = make(engine, robot)
    simulation.set_loads(None, -1, torque=(0, 0, 0.02))
    angles = equilibrium(simulation)
    turn = arms(robot, angles).turn[0, -1]
    twist = 0.02 * LENGTH / (STIFFNESS / 1.4)
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(twist, rel=1e-8)


def test_a_cable_bends_a_rod_into_the_constant_curvature_arc(engine: str, make: Make) -> None:
    """A tension T at the distance r from the axis makes the curvature T r / (E I) everywhere."""
    if "soft_cables" in load_backend(engine).capabilities:
        pytest.skip("a soft cable gives way by more than this pull")
    off = []
    for links in (3, 6, 12):
        cables = CABLES["cables"] | {"guide_offset": 0.02 * LENGTH / links}
        robot = rod_robot(links, TUBE, parts=CABLES | {"cables": cables}, time_step=0.0005)
        simulation = make(engine, robot)
        simulation.step(np.array([[-0.06, 0.05, 0.05]]), 4000)
        state = simulation.state()
        assert np.abs(state.joint_rates).max() < 1e-4
        tension = state.cable_tension[0]
        assert tension[0] > 5
        assert tension[1:].max() == 0
        bend = tension[0] * 0.01 / STIFFNESS * LENGTH
        arc = np.array([1 - np.cos(bend), 0, np.sin(bend)]) * LENGTH / bend
        off.append(np.linalg.norm(state.tip_position[0] - (0, 0, robot.top) - arc))
    assert bend > 0.6
    assert off[-1] < 1.2e-3
    assert np.abs(np.log2(np.array(off[:-1]) / off[1:]) - 2).max() < 0.2


def test_helical_cables_twist_a_rod_as_textbooks_say(stiff_engine: str, make: Make) -> None:
    """Three cables of the tension T, at the distance r, that turn by p a metre around the axis. By
    virtual work each has the torque T dL/dtheta = T r^2 p / sqrt(1 + r^2 p^2) about the axis, and
    the twist is torque x length / (G J). It unwinds the cables, and the rod stays straight. Only
    the crossings unwind, so this holds for small twists; measured within 1.4 %.
    """
    robot = rod_robot(8, TUBE, parts=helices(-90.0), time_step=0.0005)
    simulation = make(stiff_engine, robot)
    simulation.step(np.full((1, 3), -0.002), 3000)
    state = simulation.state()
    tension, angles = state.cable_tension[0], state.joint_angles[0].reshape(-1, 3)
    assert np.ptp(tension) < 1e-3
    assert tension[0] > 0.3
    # From the first guide below the first joint to the anchor, and half a cell at either end.
    run = LENGTH - LENGTH / 16
    pitch = np.deg2rad(-90) / run
    torque = -3 * tension[0] * 0.01**2 * pitch / np.sqrt(1 + (0.01 * pitch) ** 2)
    twist = torque * LENGTH / (STIFFNESS / 1.4)
    assert twist > 0.005
    assert angles[:, 2].sum() == pytest.approx(twist, rel=0.02)
    assert np.abs(angles[:, :2]).max() < 1e-6


def helices(twist_deg: float) -> dict[str, object]:
    """Return the sections of three cables that turn around the arm."""
    paths = [{"angle_deg": angle, "twist_deg": twist_deg} for angle in (0.0, 120.0, 240.0)]
    cables: dict[str, object] = {"paths": paths, "pitch_radius": 0.01, "guide_offset": 0.012}
    return {**CABLES, "cables": cables}


def test_gravity_acts_like_the_weight_of_every_link(engine: str, make: Make) -> None:
    gravity = (3.0, -4.0, -8.0)
    robot = rod_robot(6, TUBE | {"density": 5000.0})
    weighed, hanging = make(engine, robot), make(engine, changed(robot, gravity=gravity))
    for n, (link, _) in enumerate(robot.links):
        weighed.set_loads(None, n, force=link.mass * np.array(gravity))
    expected = equilibrium(weighed)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(equilibrium(hanging), expected, atol=1e-9)


def test_the_slope_of_the_forces_is_that_of_finite_differences(engine: str, make: Make) -> None:
    """Newton's steps need it. Two bent copies on a turned base, with forces off the links' axes,
    torques and weights."""
    upright, random = rod_robot(4, TUBE, TUBE, gravity=(1.0, 2.0, -9.0)), np.random.default_rng(0)
    base = upright.model_dump()["base"] | {"quaternion": (0.6, 0.0, 0.8, 0.0)}
    robot = changed(upright, base=base)
    simulation = make(engine, robot, 2)
    for link, slot in ((1, 0), (1, 1), (5, 0), (-1, 0)):
        force, torque, point = random.uniform(-1, 1, (3, 3)) * [[3.0], [0.3], [0.05]]
        simulation.set_loads([slot], link, force, torque, point, slot=slot)
    position = simulation.get_snapshot().position
    angles = random.uniform(-0.3, 0.3, (2, robot.num_hinges))
    still = np.zeros((2, robot.num_coordinates))

    def forces(angles: Array) -> Array:
        simulation.place([0, 1], np.hstack([position[:, :7], angles]), still)
        equation = simulation.dynamics()
        return (equation.passive_force - equation.bias_force)[:, 6:]

    turn = Rotation.from_quat(robot.base.quaternion, scalar_first=True).as_matrix()
    found = _slope(simulation, np.array([0, 1]), arms(robot, angles), turn)
    for hinge, step in enumerate(1e-5 * np.eye(robot.num_hinges)):
        expected = (forces(angles + step) - forces(angles - step)) / 2e-5
        np.testing.assert_allclose(found[:, :, hinge], expected, rtol=0, atol=1e-6)


def test_a_turned_base_carries_the_whole_arm(engine: str, make: Make) -> None:
    """A rod clamped along x and pulled along y bends as one along z that is pulled along y."""
    upright = rod_robot(5, TUBE)
    half = np.sqrt(0.5)
    base = upright.model_dump()["base"] | {"position": (1.0, 2.0, 3.0)}
    lying = changed(upright, base=base | {"quaternion": (half, 0.0, half, 0.0)})
    for pull in ((0.0, 0.5, 0.0), (0.0, -0.7, 0.0)):
        x, y, z = tip_of(upright, engine, make, force=pull) + np.array([0, 0, upright.top])
        simulation = make(engine, lying)
        simulation.set_loads(None, -1, force=pull)
        equilibrium(simulation)
        np.testing.assert_allclose(simulation.state().tip_position[0], (1 + z, 2 + y, 3 - x))


@pytest.mark.parametrize("turn", [(1.0, 0.0, 0.0, 0.0), (0.5, 0.5, -0.5, 0.5)])
def test_a_load_gives_a_floating_robot_its_momentum(
    turn: tuple[float, float, float, float], engine: str, make: Make
) -> None:
    """Momentum is force times time, to the first order in the step; the torque about the start
    includes the lever."""
    upright = load_robot("planar-single")
    base = upright.model_dump()["base"] | {"quaternion": turn}
    simulation = make(engine, changed(upright, base=base), 2)
    force, point = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.0, 0.15])
    simulation.set_loads([1], 2, force, point=point)
    simulation.set_loads([1], 2, torque=(0.0, 0.0, 0.02), slot=1)
    steps = 40
    where = simulation.robot.top + 2 * 0.2 + point[2]
    start = momentum(simulation)[2][1]
    for _ in range(2):  # a reset keeps the loads
        simulation.reset()
        simulation.step(np.zeros((2, simulation.robot.num_cables)), steps)
    seconds = steps * simulation.robot.time_step
    linear, angular, _ = momentum(simulation)
    np.testing.assert_allclose(linear, [np.zeros(3), force * seconds], rtol=1e-3, atol=1e-12)
    at_once = Rotation.from_quat(turn, scalar_first=True).apply([point[0], 0, where])
    lever = at_once - start
    expected = (np.cross(lever, force) + np.array([0, 0, 0.02])) * seconds
    np.testing.assert_allclose(angular[1], expected, rtol=2e-3)
    simulation.set_loads([1], 2)
    simulation.set_loads([1], 2, slot=1)
    simulation.reset()
    simulation.step(np.zeros((2, simulation.robot.num_cables)), steps)
    assert np.abs(momentum(simulation)[0]).max() < 1e-12


def test_a_floating_robot_falls(engine: str, make: Make) -> None:
    robot = changed(load_robot("planar-single"), gravity=(0.0, 0.0, -1.5))
    simulation = make(engine, robot)
    simulation.step(np.zeros((1, robot.num_cables)), 40)
    expected = -1.5 * robot.total_mass * 40 * robot.time_step
    np.testing.assert_allclose(momentum(simulation)[0], [[0, 0, expected]], rtol=1e-9, atol=1e-9)


def test_every_kind_of_arm_is_the_same_to_engine_and_closed_form(engine: str) -> None:
    """Two segments with torsion, bending in both orders, cables through both."""
    robot = rod_robot(4, TUBE, TUBE, parts=CABLES, gravity=(0.0, 1.0, -9.81))

    def make(robot: Robot, num: int) -> object:
        return make_simulation(robot, engine, num)

    checks = one_state(robot, {engine: make})  # pyright: ignore[reportArgumentType]
    assert len(checks) == 2
    assert [check for check in checks if not check.passed] == []


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ({"link": 3}, "There is no link 3; links are numbered from 0 to 2"),
        ({"link": 0, "force": (1, 2)}, "force of a load must have the shape .3,."),
        ({"link": 0, "torque": (1, 2, np.nan)}, "torque of a load must be finite"),
        ({"link": 0, "slot": -1}, "slot of a load must be a whole number from 0 to 15"),
    ],
)
def test_impossible_loads_are_refused(
    load: dict[str, object], message: str, engine: str, make: Make
) -> None:
    simulation = make(engine, rod_robot(3, TUBE))
    with pytest.raises(CdcsrError, match=message):
        simulation.set_loads(None, **load)  # pyright: ignore[reportArgumentType]
