"""Any valid description survives a round trip through TOML; a broken one is refused, and its place
named."""

from __future__ import annotations

import re
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, parse_robot
from tests.support.random_robots import few, many, robots

Wrong = tuple[tuple[str | int, ...], object, str]


@few
@given(robots())
def test_a_random_robot_is_the_same_after_a_round_trip(robot: Robot) -> None:
    again = parse_robot(robot.to_toml())
    assert again == robot
    assert again.fingerprint == robot.fingerprint


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
WRONG_IN_ITSELF: list[Wrong] = [
    (("base", "inertia"), [1.0, 2.0, 3.5], "no rigid body has this inertia"),
    (("link", "inertia"), [1.0, 2.0, 3.5], "no rigid body has this inertia"),
    (("cables", "angles_deg"), [], "at least 1 item"),
    (("joint", "limit"), 3.2, "less than or equal to 3.14"),
    (("cables", "guide_offset"), 0.26, "puts a guide outside its link"),
    (("servo", "offset"), 2.1, "puts the slider outside the base"),
    (("constraint", "recovery_time"), 0.0009, "at least two time steps"),
    (("name",), "Big Arm", "should match pattern"),
    (("servo", "colour"), 1.0, "unknown key"),
    (("wings",), 2, "unknown key"),
]
"""A place, a value that is wrong for every description drawn here, and a part of the message."""


@st.composite
def wrong_numbers(draw: st.DrawFn) -> Wrong:
    """Draw a number that is negative, infinite, not a number, or zero where it must not be."""
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


def refused(robot: Robot, wrong: Wrong, segment: int) -> None:
    """Put a wrong value into a description; the message names its place, its line and its fault."""
    place, value, said = wrong
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
    pattern = rf"line \d+, {re.escape(named)}(\[\d\])?: "
    complaints = [c for c in str(caught.value).split("; ") if re.search(pattern, c)]
    assert complaints, f"{named} is not named in: {caught.value}"
    assert any(said in complaint for complaint in complaints), complaints
    found = re.search(r"line (\d+)", complaints[0])
    key = next(key for key in reversed(place) if isinstance(key, str))
    assert found is not None
    assert text.splitlines()[int(found[1]) - 1].split("=")[0].strip() == key


@settings(few, max_examples=60)
@given(robots(), wrong_numbers(), st.integers(0, 3))
def test_a_wrong_number_is_refused(robot: Robot, wrong: Wrong, segment: int) -> None:
    refused(robot, wrong, segment)


@pytest.mark.parametrize("wrong", WRONG_IN_ITSELF, ids=lambda wrong: f"{wrong[0][-1]}={wrong[1]}")
@settings(few, max_examples=5)
@given(robots(), st.integers(0, 3))
def test_a_broken_rule_is_refused(wrong: Wrong, robot: Robot, segment: int) -> None:
    refused(robot, wrong, segment)


@pytest.mark.slow
@settings(many, max_examples=1000)
@given(robots(), wrong_numbers() | st.sampled_from(WRONG_IN_ITSELF), st.integers(0, 3))
def test_many_broken_descriptions_are_refused(robot: Robot, wrong: Wrong, segment: int) -> None:
    refused(robot, wrong, segment)
