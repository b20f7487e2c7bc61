"""The numbers of tasks that follow from a robot's size and pace."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot, shipped_robots
from cdcsr.robot.ruler import _planar_mass, answer_time, millimetres, ruler
from cdcsr.robot.scale import Scale
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.catalogue import TASKS, Capture, Follow, make_task
from cdcsr.tasks.feasible import adjusted, check_targets
from cdcsr.tasks.observation import PARTS, error_scale, input_scale
from cdcsr.tasks.spaces import SPACES, Balls, make_space
from controllers.jacobian import JacobianController

PAPER = load_robot("paper")


def _resized(size: float, pace: float) -> Robot:
    """Return the paper's robot with every length and time multiplied: a similar robot, whose
    masses stay. Forces go with mass x length / time^2."""
    data = PAPER.model_dump(mode="json")
    moment, spring = size**2, size**2 / pace**2
    data["time_step"] *= pace
    data["constraint"]["recovery_time"] *= pace
    for section in (data["base"], data["workspace"]):
        section["size"] = [size * x for x in section["size"]]
    data["workspace"]["center"] = [size * x for x in data["workspace"]["center"]]
    data["base"]["inertia"] = [moment * x for x in data["base"]["inertia"]]
    for segment in data["segments"]:
        link, joint, servo = segment["link"], segment["joint"], segment["servo"]
        link["inertia"] = [moment * x for x in link["inertia"]]
        joint["stiffness"] *= spring
        joint["damping"] *= spring * pace
        servo["damping"] /= pace
        servo["gain"] /= pace**2
        for section, names in (
            (link, ("length", "radius")),
            (segment["cables"], ("pitch_radius", "guide_offset")),
            (servo, ("eta", "radius", "offset")),
        ):
            for name in names:
                section[name] *= size
    return Robot.model_validate(data)


@pytest.mark.parametrize("name", ["paper", "three-cable", "three-segment", "planar-single"])
def test_first_robots_have_the_numbers_of_the_paper(name: str) -> None:
    robot = load_robot(name)
    assert {task: make_task(task, robot) for task in TASKS} == TASKS
    own, controller = ruler(robot), JacobianController(robot)
    spatter = 0.075 if name == "planar-single" else 0.15
    assert (own.floating, own.spatter, own.spacing, own.frame_skip) == (0.01, spatter, 0.05, 1)
    assert (controller.gain, controller.speed, controller.regularization) == (14.0, 2.0, 1e-8)
    assert (controller.calm, controller.calm_within) == (0.02, 0.1)
    widths = [part.width(robot.num_cables) for part in PARTS]
    assert input_scale(robot).tolist() == np.repeat([part.scale for part in PARTS], widths).tolist()


def test_millimetres_have_as_many_digits_as_the_threshold_asks() -> None:
    told = [millimetres(0.0123456, threshold) for threshold in (0.03, 0.01, 0.0062, 0.0015, 2e-4)]
    assert told == ["12", "12", "12.3", "12.3", "12.35"]


def test_a_similar_robot_has_similar_tasks() -> None:
    """Dimensions alone give these numbers: half of the lengths, a fifth of the times."""
    robot = _resized(0.5, 0.2)
    own, task, moved = ruler(robot), make_task("capture-drift", robot), make_task("reach", robot)
    assert answer_time(robot) == pytest.approx(0.2 * answer_time(PAPER), rel=1e-2)
    assert (task.threshold, own.spatter, own.tip_speed) == (0.015, 0.075, 5.0)
    assert (own.floating, own.spacing, own.base_shift) == (0.005, 0.025, 0.0015)
    assert own.capture_speed == 0.25
    follow = make_task("follow-circle", robot)
    assert isinstance(task, Capture)
    assert isinstance(follow, Follow)
    assert (task.speed, task.dwell, follow.settling) == (0.25, 0.02, 0.125)
    assert (follow.max_steps, follow.share, follow.size, follow.pace) == (1000, 0.9, 0.5, own.pace)
    assert error_scale(robot) == pytest.approx(0.05)
    assert (own.frame_skip, moved.max_steps, task.max_steps) == (1, 250, 500)
    controller = JacobianController(robot)
    assert controller.gain == pytest.approx(70)
    # (m/s/N)^2: speeds grow by 2.5, pulls by 0.5 / 0.2^2 = 12.5.
    assert controller.regularization == pytest.approx(1e-8 * (2.5 / 12.5) ** 2)
    env = TaskVectorEnv(1, robot, task="capture-drift")
    motion = env._episodes._motion
    env.close()
    assert motion.speed == pytest.approx(0.25)  # type: ignore[attr-defined]
    scales = {part.name: part.scale_of(robot) for part in PARTS}
    assert scales["tip_velocity"] == pytest.approx(2.5)
    assert scales["base_angular_velocity"] == pytest.approx(0.5)
    assert scales["cable_travel"] == pytest.approx(0.015)
    assert (scales["distance"], scales["base_position"]) == (0.15, 0.05)
    assert (scales["base_velocity"], scales["base_quaternion"]) == (pytest.approx(0.25), 0.1)


def test_answer_of_one_undamped_link() -> None:
    """The angle is that of a pendulum with springs, A (1 - cos w t), solved for a twelfth of the
    length at the tip."""
    length, radius, mass, inertia, gain, eta = 0.3, 0.01, 0.2, 2e-3, 200.0, 0.05
    robot = parse_robot(f"""
name = "one"
time_step = 0.001
[base]
size = [1.0, 1.0, 1.0]
mass = 1.0
inertia = [1.0, 1.0, 1.0]
mount = "fixed"
[constraint]
recovery_time = 0.01
[workspace]
center = [0.1, 0.0, 0.6]
size = [0.0, 0.0, 0.0]
[[segments]]
links = 1
link = {{ length = {length}, radius = 0.01, mass = {mass}, inertia = [{inertia}, {inertia}, 1e-4] }}
joint = {{ stiffness = 0.0, damping = 0.0, limit = 1.0 }}
cables = {{ angles_deg = [0.0, 180.0], pitch_radius = {radius}, guide_offset = 0.01 }}
servo = {{ mass = 0.1, damping = 0.0, gain = {gain}, eta = {eta}, radius = 0.01, offset = 0.1 }}
""")
    whole = inertia + mass * (length / 2) ** 2 + 0.1 * radius**2
    amplitude = gain * eta * radius / (gain * radius**2)
    expected = math.acos(1 - 1 / 12 / amplitude) / math.sqrt(gain * radius**2 / whole)
    assert answer_time(robot) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("mount", ["free", "fixed"])
def test_the_mass_matrix_in_the_plane_is_the_engines(mount: str) -> None:
    """MuJoCo's mass matrix of the straight arm, at shift along x, tilt and bend about y. The upper
    segment is lighter, and its links' centres of mass are not in their middles. Sliders, which move
    with the base, weigh nothing."""
    data = PAPER.model_dump()
    for segment in data["segments"]:
        segment["servo"]["mass"] = 1e-8
    data["base"] |= {"mount": mount, "mass": 20.0, "inertia": (4.0, 3.5, 5.0)}
    data["segments"][1]["link"] |= {"mass": 0.4, "center": 0.13, "inertia": (0.0052, 0.005, 3e-4)}
    robot = Robot.model_validate(data)
    mass, tip = _planar_mass(robot)
    simulation = make_simulation(robot, "mujoco")
    dynamics = simulation.dynamics()
    simulation.close()
    first = 6 + robot.num_cables
    plane = [0, 4] if mount == "free" else []
    plane += range(first + 1, first + robot.num_hinges, 2)
    whole = dynamics.mass_matrix[0][np.ix_(plane, plane)]
    np.testing.assert_allclose(mass, whole, rtol=1e-7)
    np.testing.assert_allclose(tip, dynamics.tip_jacobian[0][0, plane], rtol=1e-9, atol=1e-12)


def test_the_section_of_a_rulers_numbers_gives_the_same_ruler_to_the_robot() -> None:
    robot = _resized(0.5, 0.2)
    own = ruler(robot)
    assert (own.size, own.pace, own.speed) == (
        0.5,
        pytest.approx(0.2, rel=1e-2),
        own.size / own.pace,
    )
    again = ruler(robot.model_copy(update={"scale": own.scale}))
    assert again == own
    assert own.scale.length == pytest.approx(1.2)
    assert own.scale.time == pytest.approx(answer_time(robot), rel=5e-3)


def test_an_arm_without_cables_has_the_pace_of_the_papers() -> None:
    data = PAPER.model_dump()
    for segment in data["segments"]:
        segment["cables"] = segment["servo"] = None
    robot = Robot.model_validate(data)
    assert (ruler(robot).pace, ruler(robot).travel, ruler(robot).pull) == (1.0, 1.0, 1.0)
    assert answer_time(robot) == pytest.approx(answer_time(PAPER), rel=1e-4)


def test_numbers_of_the_description_come_first() -> None:
    robot = PAPER.model_copy(update={"scale": Scale(threshold=0.02, seconds=1.0, tip_speed=0.5)})
    assert robot.fingerprint == PAPER.fingerprint  # a policy acts on it
    assert (make_task("reach", robot).name, make_task("reach", robot).threshold) == ("reach", 0.02)
    precise = make_task("precise", robot)
    assert precise.name == "precise"
    assert precise.threshold == pytest.approx(0.02 / 3)
    assert (precise.max_steps, ruler(robot).frame_skip) == (400, 2)
    assert JacobianController(robot).speed == 0.5
    assert parse_robot(robot.to_toml()) == robot
    assert make_task("reach", robot, threshold=0.04).name == "reach-40mm"


def test_options_change_the_task_that_is_asked_for() -> None:
    robot = adjusted(PAPER, "precise", ["spatter"], threshold=0.005, seconds=0.5, radius=0.2)
    task, space = make_task("precise", robot), make_space("spatter", robot)
    assert task.threshold == pytest.approx(0.005)
    assert (task.max_steps, ruler(robot).frame_skip) == (200, 1)
    assert isinstance(space, Balls)
    assert space.radius == 0.2
    assert adjusted(PAPER, "reach", ["anchor"]) is PAPER
    with pytest.raises(CdcsrError, match="seconds must be positive and finite, not -1"):
        adjusted(PAPER, "reach", [], seconds=-1.0)
    with pytest.raises(CdcsrError, match=r"choose one of them with --space \(found anchor\)"):
        adjusted(PAPER, "reach", ["anchor"], radius=0.1)
    with pytest.raises(CdcsrError, match=r"of one space, .* \(found floating, spatter\)"):
        adjusted(PAPER, "reach", ["floating", "spatter"], radius=0.1)
    for wrong in (0.0, math.inf, math.nan):
        with pytest.raises(CdcsrError, match="radius must be positive and finite"):
            adjusted(PAPER, "reach", ["spatter"], radius=wrong)


class _Places:
    """A space in which a share of all targets lies at one point, and the others at another."""

    name = "places"

    def __init__(self, share: float, height: float, others: float = 2.0) -> None:
        self._share, self._heights = share, (height, others)

    def sample(self, rng: np.random.Generator, num: int) -> np.ndarray:
        """Return targets above the origin, shape (num, 3), in [m]."""
        count = round(self._share * num)
        return np.repeat(self._heights, (count, num - count))[:, None] * [0.0, 0.0, 1.0]


def test_how_many_targets_may_be_reached_at_once_or_out_of_reach() -> None:
    """The tip is at z = 2.7 m and the first joint at 0.3 m, so that with a threshold of 0.03 m
    targets from 2.67 m on are reached at once, and those beyond 2.73 m never."""
    task = make_task("reach", PAPER)
    check_targets(PAPER, task, _Places(0.01, 2.671))
    check_targets(PAPER, task, _Places(0.02, 2.669))
    check_targets(PAPER, task, _Places(0.01, 2.731))
    check_targets(PAPER, task, _Places(1.0, 2.729), bent=True)  # a bent arm is not there
    with pytest.raises(CdcsrError, match=r"2\.0% of the targets in the space 'places' lie within"):
        check_targets(PAPER, task, _Places(0.02, 2.671))
    for bent in (False, True):
        with pytest.raises(CdcsrError, match=r"1\.5% .* are out of reach: .* the 2\.4 m that"):
            check_targets(PAPER, task, _Places(0.015, 2.731), bent)


@pytest.mark.parametrize("name", shipped_robots())
def test_targets_of_shipped_robots_make_a_task(name: str) -> None:
    robot = load_robot(name)
    for space in SPACES:
        check_targets(robot, make_task("reach", robot), make_space(space, robot))


def test_targets_that_make_no_task_are_refused() -> None:
    """The straight arm's tip is at z = 0.3 + 2.4 m, its first joint at 0.3 m."""
    task = make_task("reach", PAPER)
    with pytest.raises(CdcsrError, match=r"100\.0% .* threshold of 0\.5 m .* at \(0, 0, 2\.7\) m"):
        check_targets(PAPER, replace(task, threshold=0.5), make_space("anchor", PAPER))
    high = PAPER.workspace.model_copy(update={"center": (0.0, 0.0, 2.9)})
    robot = PAPER.model_copy(update={"workspace": high})
    with pytest.raises(CdcsrError, match=r"out of reach: .* the 2\.4 m .* at \(0, 0, 0\.3\) m"):
        check_targets(robot, task, make_space("anchor", robot))
    # A turned base turns the arm: now it points down, and the tip is at z = -2.7 m.
    turned = PAPER.base.model_copy(update={"quaternion": (0.0, 1.0, 0.0, 0.0)})
    robot = PAPER.model_copy(update={"base": turned})
    with pytest.raises(CdcsrError, match=r"at \(0, 0, -0\.3\) m"):
        check_targets(robot, task, make_space("anchor", robot))
