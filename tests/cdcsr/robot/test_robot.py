"""The description is read and written exactly, and every error in it is reported with its line."""

from __future__ import annotations

import math
from importlib import resources

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot, shipped_robots

_SHIPPED = (resources.files("models") / "robots" / "paper.toml").read_text("utf-8")
# With other comments, so that the line numbers below do not depend on those of the shipped file.
PAPER = "# A robot.\n" + "".join(
    "# A comment.\n" * line.startswith("inertia = [40.0") + line
    for line in _SHIPPED.splitlines(keepends=True)
    if not line.startswith("#")
)


def broken(*edits: tuple[str, str]) -> str:
    """Return the error for the paper's robot after replacing the first occurrence of some texts."""
    text = PAPER
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(CdcsrError) as caught:
        parse_robot(text, "my.toml")
    return str(caught.value)


def one_error(place: str) -> str:
    return f"my.toml: 1 error in the robot description: {place}"


def positive(low: float = 1e-3, high: float = 1e3) -> st.SearchStrategy[float]:
    return st.floats(low, high)


@st.composite
def inertias(draw: st.DrawFn) -> tuple[float, float, float]:
    """Draw the inertia of a rigid body: each moment is the sum of two second moments of mass."""
    x, y, z = draw(positive()), draw(positive()), draw(positive())
    return (y + z, x + z, x + y)


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    """Robots that keep every rule, of one to three segments with three to five cables each."""
    lengths = draw(st.lists(positive(0.01, 2), min_size=1, max_size=3))
    height = draw(positive(0.5, 5))
    segments = []
    for i, length in enumerate(lengths):
        offset = draw(st.floats(0.01, 0.49)) * min(*lengths[: i + 1], height, 1.0)
        segments.append(
            {
                "links": draw(st.integers(1, 8)),
                "link": {
                    "length": length,
                    "radius": draw(positive()),
                    "mass": draw(positive()),
                    "inertia": draw(inertias()),
                },
                "joint": {
                    "stiffness": draw(st.floats(0, 10)),
                    "damping": draw(st.floats(0, 10)),
                    "limit": draw(st.floats(0.01, 3.14)),
                },
                "cables": {
                    "angles_deg": draw(st.lists(st.floats(-360, 360), min_size=3, max_size=5)),
                    "pitch_radius": draw(positive()),
                    "guide_offset": offset,
                },
                "servo": {
                    "mass": draw(positive()),
                    "damping": draw(st.floats(0, 100)),
                    "gain": draw(positive()),
                    "eta": draw(positive()),
                    "radius": draw(positive()),
                    "offset": draw(st.floats(0.01, 0.99)) * (height - offset),
                },
            }
        )
    step = draw(positive(1e-5, 0.1))
    return Robot.model_validate(
        {
            "name": draw(st.from_regex(r"\A[a-z][a-z0-9-]{0,10}\Z")),
            "time_step": step,
            "base": {
                "size": (draw(positive()), draw(positive()), height),
                "mass": draw(positive()),
                "inertia": draw(inertias()),
            },
            "constraint": {"recovery_time": step * draw(st.floats(2, 10))},
            "workspace": {
                "center": draw(st.tuples(*[st.floats(-10, 10)] * 3)),
                "size": draw(st.tuples(*[st.floats(0, 10)] * 3)),
            },
            "segments": segments,
        }
    )


@pytest.mark.parametrize("name", shipped_robots())
def test_a_shipped_robot_survives_a_round_trip(name: str) -> None:
    robot = load_robot(name)
    again = parse_robot(robot.to_toml())
    assert again == robot
    assert again.fingerprint == robot.fingerprint
    assert robot.name == name


@settings(max_examples=50, deadline=None)
@given(robots())
def test_any_robot_survives_a_round_trip(robot: Robot) -> None:
    again = parse_robot(robot.to_toml())
    assert again == robot
    assert again.fingerprint == robot.fingerprint


def test_the_paper_robot_has_the_papers_numbers() -> None:
    robot = load_robot("paper")
    assert (robot.num_segments, robot.num_links, robot.num_hinges, robot.num_cables) == (
        2,
        12,
        24,
        8,
    )
    assert robot.num_coordinates == 6 + 8 + 24
    assert robot.top + robot.arm_length == pytest.approx(2.7)
    assert robot.total_mass == pytest.approx(500 + 12 * 1.18 + 8 * 0.2)


def test_the_fingerprint_follows_the_numbers_and_not_the_name() -> None:
    robot = load_robot("paper")
    assert parse_robot(PAPER.replace('"paper"', '"other"')).fingerprint == robot.fingerprint
    assert parse_robot(PAPER.replace("eta = 5.0", "eta = 5.1", 1)).fingerprint != robot.fingerprint


def test_a_whole_number_may_stand_for_a_float() -> None:
    assert parse_robot(PAPER.replace("mass = 500.0", "mass = 500")) == load_robot("paper")


def test_all_broken_rules_are_reported_at_once_each_with_its_line() -> None:
    message = broken(
        ("mass = 500.0", "mass = -5.0"),
        ("75.0]", "100.0]"),
        ("recovery_time = 0.005", "recovery_time = 0.004"),
        ("links = 6", "links = 0"),
        ("length = 0.2", "length = 0.03"),
        ("radius = 0.02", "radus = 0.02"),
        ("limit = 1.5", 'limit = "1.5"'),
        ("gain = 50.0", "gain = nan"),
        ("eta = 5.0", "eta = true"),
    )
    head, _, errors = message.partition(": 11 errors in the robot description: ")
    assert head == "my.toml"
    assert errors.split("; ") == [
        "line 7, base.mass: should be greater than 0 (found -5.0)",
        "line 9, base.inertia: no rigid body has this inertia: 100 exceeds 35 + 40 (the largest "
        "principal moment is at most the sum of the other two) (found [40.0, 35.0, 100.0])",
        "line 19, segments[0].links: should be greater than or equal to 1 (found 0)",
        "line 21, segments[0].link.radius: Field required",
        "line 23, segments[0].link.radus: unknown key (found 0.02)",
        "line 30, segments[0].joint.limit: should be a valid number (found '1.5')",
        "line 40, segments[0].servo.gain: should be a finite number (found nan)",
        "line 41, segments[0].servo.eta: should be a valid number (found True)",
        "line 12, constraint.recovery_time: must be at least two time steps (0.005 s) "
        "(found 0.004)",
        "line 35, segments[0].cables.guide_offset: puts a guide outside its link: must be below "
        "half of segments[0].link.length (0.015 m) (found 0.02)",
        "line 62, segments[1].cables.guide_offset: puts a guide outside its link: must be below "
        "half of segments[0].link.length (0.015 m) (found 0.02)",
    ]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "mass = 500.0",
            'mass = "heavy"',
            "line 7, base.mass: should be a valid number (found 'heavy')",
        ),
        ("[0.6, 0.6, 0.6]", "0.6", "line 6, base.size: should be a valid tuple (found 0.6)"),
        (
            "links = 6",
            "links = 6.0",
            "line 19, segments[0].links: should be a valid integer (found 6.0)",
        ),
        (
            "links = 6",
            "links = true",
            "line 19, segments[0].links: should be a valid integer (found True)",
        ),
        ("2.45]", "nan]", "line 15, workspace.center[2]: should be a finite number (found nan)"),
        (
            "gain = 50.0",
            "gain = inf",
            "line 40, segments[0].servo.gain: should be a finite number (found inf)",
        ),
        ("[base]", "wings = 2\n[base]", "line 5, wings: unknown key (found 2)"),
        ("[base]", "[wings]\nspan = 2\n[base]", "line 5, wings: unknown key"),
        ("time_step = 0.0025\n", "", "time_step: Field required"),
        (
            "offset = 0.2\n",
            "offset = 0.6\n",
            "line 43, segments[0].servo.offset: puts the slider outside the base: must be at most "
            "0.58 m (found 0.6)",
        ),
        (
            "guide_offset = 0.02",
            "guide_offset = 0.1",
            "line 35, segments[0].cables.guide_offset: puts a guide outside its link: must be "
            "below half of segments[0].link.length (0.1 m) (found 0.1)",
        ),
    ],
)
def test_one_broken_rule(old: str, new: str, expected: str) -> None:
    assert broken((old, new)) == one_error(expected)


@pytest.mark.parametrize(
    "moments", [(1.0, 1.0, 2.1), (2.1, 1.0, 1.0), (0.0, 1.0, 1.0), (-1.0, 1.0, 1.0)]
)
def test_an_impossible_inertia_is_refused(moments: tuple[float, float, float]) -> None:
    assert "base.inertia" in broken(("[40.0, 35.0, 75.0]", str(list(moments))))


def test_a_flat_body_has_a_possible_inertia() -> None:
    # A thin plate: the moment across it is exactly the sum of the two along it.
    robot = parse_robot(PAPER.replace("[40.0, 35.0, 75.0]", "[0.1, 0.2, 0.30000000000000004]", 1))
    assert math.isclose(robot.base.inertia[2], 0.3)


def test_text_that_is_not_toml() -> None:
    assert broken(("[base]", "[base")).startswith("my.toml is not valid TOML: ")


def test_an_unknown_robot_gets_a_suggestion() -> None:
    with pytest.raises(CdcsrError) as caught:
        load_robot("papr")
    known = ", ".join(shipped_robots())
    assert str(caught.value) == (
        f"Unknown robot 'papr'. Did you mean 'paper'? Available: {known}. "
        "Or give a path ending in .toml."
    )


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(CdcsrError, match=r"^Cannot read the robot description nowhere\.toml: "):
        load_robot("nowhere.toml")
