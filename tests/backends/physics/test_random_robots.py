"""Any valid description becomes the same robot in every engine; any broken one is refused with its
place named.

The fast tests draw the same few descriptions every time, so that they repeat; the slow ones draw
many new ones.
"""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, parse_robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.contract import Array
from tests.support.physics import moving, running

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
many = settings(max_examples=200, deadline=None, database=None)


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def inertias(draw: st.DrawFn, scale: float) -> tuple[float, float, float]:
    """Any rigid body's: each moment is the sum of two of three second moments of mass."""
    x, y, z = (scale * draw(between(0.1, 1)) for _ in "xyz")
    return (y + z, x + z, x + y)


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    """1 to 4 segments of 1 to 10 links and 3 to 6 cables each, from centimetres to metres and grams
    to tonnes.

    Mass goes with size, as it does in matter: a step of half a millisecond then is short for every
    spring.
    """
    height, heavy = draw(between(0.2, 2)), draw(between(20, 2000))
    segments: list[dict[str, Any]] = []
    shortest = height
    for _ in range(draw(st.integers(1, 4))):
        length, mass = draw(between(0.03, 0.5)), draw(between(0.1, 5))
        shortest = min(shortest, length)
        offset = draw(between(0.05, 0.45)) * shortest
        joint = {
            "stiffness": draw(between(0, 5)),
            "damping": draw(between(0.05, 3)),
            "limit": draw(between(0.5, 3)),
        }
        angles = draw(st.lists(between(-360, 360), min_size=3, max_size=6))
        segments.append(
            {
                "links": draw(st.integers(1, 10)),
                "link": {
                    "length": length,
                    "radius": draw(between(0.005, 0.1)),
                    "mass": mass,
                    "inertia": draw(inertias(mass * length**2 / 5)),
                },
                "joint": joint,
                "cables": {
                    "angles_deg": angles,
                    "pitch_radius": draw(between(0.01, 0.1)),
                    "guide_offset": offset,
                },
                "servo": {
                    "mass": draw(between(0.05, 1)),
                    "damping": draw(between(0, 50)),
                    "gain": draw(between(5, 100)),
                    "eta": draw(between(0.1, 5)),
                    "radius": draw(between(0.005, 0.05)),
                    "offset": draw(between(0.3, 0.99)) * (height - offset),
                },
            }
        )
    base = {
        "size": (draw(between(0.1, 1)), 0.5, height),
        "mass": heavy,
        "inertia": draw(inertias(heavy / 10)),
    }
    return Robot.model_validate(
        {
            "name": draw(st.from_regex(r"\A[a-z][a-z0-9-]{0,10}\Z")),
            "time_step": 0.0005,
            "base": base,
            "constraint": {"recovery_time": 0.0005 * draw(between(2, 10))},
            "workspace": {"center": (0.0, 0.0, 1.0), "size": (0.1, 0.0, 0.2)},
            "segments": segments,
        }
    )


def guide_by_guide(robot: Robot, travel: Array, hinges: Array) -> Array:
    """Length of every cable as the distances from point to point, shape (C,), in [m]; walks out
    along the arm."""
    cosine, sine = np.cos(hinges), np.sin(hinges)
    turns = np.stack([cosine[::2], sine[::2], cosine[1::2], sine[1::2]], axis=1)
    crossed = [(link.length, *turn) for (link, _), turn in zip(robot.links, turns, strict=True)]
    lengths, number, last = [], 0, 0
    for segment in robot.segments:
        cables, last = segment.cables, last + segment.links
        for angle in np.deg2rad(cables.angles_deg):
            x, y = cables.pitch_radius * np.cos(angle), cables.pitch_radius * np.sin(angle)
            first = robot.base.size[2] / 2 - cables.guide_offset
            points = [
                np.array([x, y, first - segment.servo.offset + travel[number]]),
                np.array([x, y, first]),
            ]
            turned, place = np.eye(3), np.array([0, 0, robot.base.size[2] / 2])
            for length, cx, sx, cy, sy in crossed[:last]:
                about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
                turned = turned @ about_x @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
                points += [
                    place + turned @ [x, y, z]
                    for z in (cables.guide_offset, length - cables.guide_offset)
                ]
                place = place + turned @ [0, 0, length]
            lengths.append(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            number += 1
    return np.array(lengths)


def same_robot_in_every_engine(robot: Robot) -> None:
    """At tilted, spinning, bent states: mass matrix, Jacobians and bias to 1e-10, cable lengths to
    1e-9 m."""
    snapshot, route, cables = moving(robot, 3, bend=0.5), routing(robot), robot.num_cables
    travel, hinges = snapshot.position[:, 7 : 7 + cables], snapshot.position[:, 7 + cables :]
    with running(robot, "mujoco", 3) as one, running(robot, "pybullet", 3) as other:
        one.set_snapshot(snapshot)
        other.set_snapshot(snapshot)
        left, right, states = one.dynamics(), other.dynamics(), (one.state(), other.state())
        assert isinstance(one, MujocoSimulation)
        data = mujoco.MjData(one.model)
        for n in range(3):
            size = np.sqrt(np.diag(left.mass_matrix[n]))
            assert (
                np.max(np.abs(left.mass_matrix[n] - right.mass_matrix[n]) / np.outer(size, size))
                < 1e-10
            )
            one.write_to(data, n)
            mujoco.mj_forward(one.model, data)
            closed_form = cable_lengths(route, travel[n], hinges[n])
            np.testing.assert_allclose(data.ten_length, closed_form, rtol=0, atol=1e-9)
            np.testing.assert_allclose(
                guide_by_guide(robot, travel[n], hinges[n]), closed_form, rtol=0, atol=1e-9
            )
        for name in ("tip_jacobian", "cable_jacobian", "bias_force", "passive_force", "velocity"):
            found, expected = getattr(left, name), getattr(right, name)
            np.testing.assert_allclose(
                found, expected, rtol=0, atol=1e-10 * np.abs(expected).max(), err_msg=name
            )
        for name in ("tip_position", "tip_velocity", "base_angular_velocity"):
            np.testing.assert_allclose(
                *(getattr(state, name) for state in states), rtol=0, atol=1e-10, err_msg=name
            )
        for simulation in (one, other):
            simulation.reset()
            simulation.step(np.full((3, cables), -0.1), 20)  # and it moves without diverging
            assert simulation.state().cable_tension.min() >= 0


def same_after_a_round_trip(robot: Robot) -> None:
    again = parse_robot(robot.to_toml())
    assert again == robot
    assert again.fingerprint == robot.fingerprint


@few
@given(robots())
def test_a_random_robot_is_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)
    same_after_a_round_trip(robot)


@pytest.mark.slow
@many
@given(robots())
def test_many_random_robots_are_the_same_in_every_engine(robot: Robot) -> None:
    same_robot_in_every_engine(robot)
    same_after_a_round_trip(robot)


POSITIVE = [
    ("time_step",),
    ("base", "mass"),
    ("base", "size", 1),
    ("constraint", "recovery_time"),
    ("link", "length"),
    ("link", "radius"),
    ("link", "mass"),
    ("joint", "limit"),
    ("cables", "pitch_radius"),
    ("cables", "guide_offset"),
    ("servo", "mass"),
    ("servo", "gain"),
    ("servo", "eta"),
    ("servo", "radius"),
    ("servo", "offset"),
    ("links",),
]
NOT_NEGATIVE = [("joint", "stiffness"), ("joint", "damping"), ("servo", "damping")]
WRONG_IN_ITSELF: list[tuple[tuple[str | int, ...], object, str]] = [
    (("base", "inertia"), [1.0, 2.0, 3.5], "no rigid body has this inertia"),
    (("link", "inertia"), [1.0, 2.0, 3.5], "no rigid body has this inertia"),
    (("cables", "angles_deg"), [0.0, 90.0], "at least 3 items"),
    (("joint", "limit"), 3.2, "less than or equal to 3.14"),
    (("cables", "guide_offset"), 0.26, "puts a guide outside its link"),
    (("servo", "offset"), 2.1, "puts the slider outside the base"),
    (("constraint", "recovery_time"), 0.0009, "at least two time steps"),
    (("name",), "Big Arm", "should match pattern"),
    (("servo", "colour"), 1.0, "unknown key"),
    (("wings",), 2, "unknown key"),
]
"""A place, a value that is wrong for every description drawn here, and what is said about it."""


@st.composite
def wrong_numbers(draw: st.DrawFn) -> tuple[tuple[str | int, ...], object, str]:
    """A number that is negative, zero where it must not be, infinite, or no number."""
    place = draw(st.sampled_from(POSITIVE + NOT_NEGATIVE))
    values: list[tuple[object, str]] = [
        (-1, "greater than"),
        ("1.0", "valid"),
        (True, "valid"),
        ([1.0], "valid"),
    ]
    if place != ("links",):
        values += [(float("nan"), "finite"), (float("inf"), "finite")]
    if place in POSITIVE:
        values.append((0, "greater than"))
    return place, *draw(st.sampled_from(values))


def refused(
    robot: Robot, place: tuple[str | int, ...], value: object, said: str, segment: int
) -> None:
    """Put a wrong value into a description; its place, its line and what is wrong are in the
    message."""
    if place[0] in ("links", "link", "joint", "cables", "servo"):
        place = ("segments", segment % robot.num_segments, *place)
    data: Any = robot.model_dump(mode="json")
    section = data
    for key in place[:-1]:
        section = section[key]
    section[place[-1]] = value
    text = tomli_w.dumps(data)
    with pytest.raises(CdcsrError) as caught:
        parse_robot(text, "my.toml")
    named = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place).lstrip(".")
    complaints = [
        c
        for c in str(caught.value).split("; ")
        if re.search(rf"line \d+, {re.escape(named)}(\[\d\])?: ", c)
    ]
    assert complaints, f"{named} is not named in: {caught.value}"
    assert any(said in complaint for complaint in complaints), complaints
    found = re.search(r"line (\d+)", complaints[0])
    key = next(key for key in reversed(place) if isinstance(key, str))
    assert found is not None
    assert text.splitlines()[int(found[1]) - 1].split("=")[0].strip() == key


@settings(few, max_examples=60)
@given(robots(), wrong_numbers(), st.integers(0, 3))
def test_a_wrong_number_is_refused(
    robot: Robot, wrong: tuple[Any, object, str], segment: int
) -> None:
    refused(robot, *wrong, segment)


@pytest.mark.parametrize("wrong", WRONG_IN_ITSELF, ids=lambda wrong: f"{wrong[0][-1]}={wrong[1]}")
@settings(few, max_examples=5)
@given(robots(), st.integers(0, 3))
def test_a_broken_rule_is_refused(
    wrong: tuple[Any, object, str], robot: Robot, segment: int
) -> None:
    refused(robot, *wrong, segment)


@pytest.mark.slow
@settings(many, max_examples=1000)
@given(robots(), wrong_numbers() | st.sampled_from(WRONG_IN_ITSELF), st.integers(0, 3))
def test_many_broken_descriptions_are_refused(
    robot: Robot, wrong: tuple[Any, object, str], segment: int
) -> None:
    refused(robot, *wrong, segment)
