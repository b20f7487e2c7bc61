"""Descriptions of new arms, against the laws of similarity and numbers by hand."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, parse_robot
from cdcsr.robot.sizing import NewRobot
from cdcsr.robot.stability import stable_step

_FALL = 9.81


def _made(**changes: Any) -> Robot:
    return parse_robot(_text(**changes))


def _text(**changes: Any) -> str:
    usual: dict[str, Any] = {"name": "a", "length": 2.4, "segments": 2, "cables": 4, "links": 6}
    return NewRobot(**{**usual, **changes}).text()


@pytest.mark.parametrize(
    ("name", "least", "most", "by"),
    [
        ("length", 0.05, 100.0, 1e-6),
        ("segments", 1, 16, 1),
        ("cables", 3, 12, 1),
        ("links", 1, 100, 1),
        ("base_mass", 1e-6, 1e8, 1e-7),
    ],
)
def test_bounds_are_allowed_and_what_is_beyond_is_not(
    name: str, least: float, most: float, by: float
) -> None:
    usual: dict[str, Any] = {"name": "a", "length": 2.4, "segments": 2, "cables": 4, "links": 6}
    for inside in (least, most):
        assert getattr(NewRobot(**{**usual, name: inside}), name) == inside
    for outside in (least - by, most + by):
        message = re.escape(f"{name} must lie between {least:g} and {most:g}, not {outside:g}.")
        with pytest.raises(CdcsrError, match=message):
            NewRobot(**{**usual, name: outside})


def test_every_number_follows_its_law_of_similarity() -> None:
    """An arm a quarter as long has half of the times, and masses and forces divided by 4^3."""
    large, small = _made(), _made(length=0.6)

    def check(a: float, b: float, power: float, rel: float = 2e-3) -> None:
        assert b == pytest.approx(a / 4**power, rel), (a, b, power)

    check(large.time_step, small.time_step, 0.5, rel=0.05)  # it has two digits
    assert small.constraint.recovery_time == pytest.approx(2 * small.time_step)
    check(large.base.mass, small.base.mass, 3)
    for axis in range(3):
        check(large.base.size[axis], small.base.size[axis], 1)
        check(large.base.inertia[axis], small.base.inertia[axis], 5)
        check(large.workspace.size[axis], small.workspace.size[axis], 1)
        check(large.workspace.center[axis], small.workspace.center[axis], 1)
    (a, b), (c, d) = large.links[0], small.links[0]
    one, other = large.segments[1], small.segments[1]
    for axis in range(3):
        check(a.inertia[axis], c.inertia[axis], 5)
    for whole, part, powers in (
        (a, c, {"length": 1, "radius": 1, "mass": 3}),
        (b, d, {"stiffness": 4, "damping": 4.5, "limit": 0}),
        (one.cables, other.cables, {"pitch_radius": 1, "guide_offset": 1}),
        (one.servo, other.servo, {"mass": 3, "damping": 2.5, "gain": 2, "eta": 1}),
        (one.servo, other.servo, {"radius": 1, "offset": 1}),
    ):
        for name, power in powers.items():
            check(getattr(whole, name), getattr(part, name), power)


def test_more_links_keep_the_arm_as_heavy_and_as_stiff() -> None:
    few, many = _made(links=6), _made(links=12)
    assert many.arm_length == pytest.approx(few.arm_length)
    assert many.total_mass == pytest.approx(few.total_mass, rel=1e-3)
    (_, one), (link, other) = few.links[0], many.links[0]
    # Springs in series: twice as many hinges, each twice as stiff.
    assert other.stiffness == pytest.approx(2 * one.stiffness, rel=1e-3)
    # A solid cylinder, from any textbook.
    mass, radius, length = link.mass, link.radius, link.length
    across = mass * radius**2 / 4 + mass * length**2 / 12
    expected = (across, across, mass * radius**2 / 2)
    assert link.inertia == pytest.approx(expected, rel=1e-3)
    assert many.segments[0].cables.guide_offset == pytest.approx(0.02)
    assert _made(length=1.0).segments[0].cables.pitch_radius == 0.008333  # it has four digits
    assert _made(links=100).segments[0].cables.guide_offset == pytest.approx(0.2 * 2.4 / 200)


def test_cables_are_spread_evenly_over_all_segments() -> None:
    """Each of three segments with four cables is turned by a third of the 90 degrees between."""
    robot = _made(segments=3)
    for number, segment in enumerate(robot.segments):
        expected = [30.0 * number + 90.0 * k for k in range(4)]
        assert list(segment.cables.angles_deg) == pytest.approx(expected, abs=1e-3)


def test_the_base_and_the_cuboid_are_as_asked() -> None:
    """The paper's base weighs 500 kg at edges of 0.6 m; a light one is a quarter of the size."""
    robot = _made(base_mass=4000.0, cuboid=2.5)
    assert robot.base.mass == 4000
    assert robot.base.size == pytest.approx((1.2, 1.2, 1.2))
    assert robot.base.inertia == pytest.approx(3 * (4000 * 1.2**2 / 6,))
    assert robot.workspace.size == pytest.approx(3 * (0.5,))
    # Half the edge, and the arm less a quarter of a metre.
    assert robot.workspace.center == pytest.approx((0.2, 0.1, 0.6 + 2.15))
    assert _made(base_mass=1.0).base.size == pytest.approx(3 * (0.25,))
    assert robot.base.mount == "free"
    assert not any(robot.gravity)


def test_a_hanging_arm_is_held_by_one_cable() -> None:
    """The weight acts on a lever of 0.04 of the length, the middle of the cuboid, and the cable on
    one of its pitch radius; a small robot's servos, in proportion, are weaker than that."""
    robot = _made(length=2.4, gravity=True, mount="fixed")
    assert robot.gravity == (0.0, 0.0, -_FALL)
    weight = 12 * 1.18 * _FALL
    servo, radius = robot.segments[0].servo, robot.segments[0].cables.pitch_radius
    assert servo.gain * servo.eta * radius == pytest.approx(weight * 0.04 * 2.4, rel=1e-3)
    assert robot.workspace.center[2] == pytest.approx(-(0.3 + 2.15))
    assert robot.base.quaternion == (0.0, 1.0, 0.0, 0.0)
    assert robot.base.mount == "fixed"
    # A robot of 20 m has servos that are strong enough in proportion to the cube.
    large = _made(length=24.0, gravity=True)
    pull = large.segments[0].servo.gain * large.segments[0].servo.eta
    assert pull == pytest.approx(max(250e3, 12 * 1.18e3 * _FALL * 0.04 * 24 / 0.2), rel=1e-3)


def test_the_step_is_that_which_is_given_or_that_which_is_stable() -> None:
    given = _made(step=0.001)
    assert (given.time_step, given.constraint.recovery_time) == (0.001, 0.002)
    assert _made().time_step == 0.0025
    # Many short links are stiff and light: the step is just below the stable one.
    stiff = _made(links=100)
    assert stiff.time_step < 0.0025
    assert stiff.time_step == pytest.approx(0.95 * stable_step(stiff), rel=0.05)
    assert stiff.time_step < stable_step(stiff)


def test_the_comments_say_what_the_numbers_are() -> None:
    text = _text(segments=3, cables=5, links=7, length=1.2)
    robot = parse_robot(text)
    (_, joint), servo = robot.links[0], robot.segments[0].servo
    assert "An arm of 1.2 m" in text
    assert "3 segments of 7 links,\n# with 5 cables each" in text
    assert "Segment 1 of 3" in text
    assert "Segment 3 of 3" in text
    bend, weight = re.findall(r"by\n# (\S+) rad; .* weighs (\S+) N", text)[0]
    pull = re.findall(r"gain \* eta = (\S+) N", text)[0]
    assert float(pull) == pytest.approx(servo.gain * servo.eta, rel=5e-3)
    pitch = robot.segments[0].cables.pitch_radius
    assert float(bend) == pytest.approx(servo.gain * servo.eta * pitch / joint.stiffness, rel=0.05)
    arm = sum(link.mass for link, _ in robot.links)
    assert float(weight) == pytest.approx(arm * _FALL, rel=5e-3)
    assert math.isclose(robot.arm_length, 1.2, rel_tol=1e-5)
