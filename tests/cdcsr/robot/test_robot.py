"""The description is read and written exactly, and every error in it is reported with its line."""

from __future__ import annotations

import math
import os
import time
from importlib import resources
from pathlib import Path

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
def bodies(draw: st.DrawFn, reach: float) -> dict[str, object]:
    """Draw a mass within some distance of its centre, and its moments: each is the sum of two
    second moments of mass."""
    mass = draw(positive())
    x, y, z = (mass * reach**2 * draw(st.floats(1e-3, 0.5)) for _ in "xyz")
    return {"mass": mass, "inertia": (y + z, x + z, x + y)}


def directions() -> st.SearchStrategy[list[float]]:
    """Draw the directions of three to five cables, not all of them the same, in degrees."""
    angles = st.lists(st.floats(-360, 360), min_size=3, max_size=5)
    return angles.filter(
        lambda found: any(math.cos(math.radians(a - found[0])) < 0.999 for a in found)
    )


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    """Robots that keep every rule, of one to three segments with three to five cables each."""
    lengths = draw(st.lists(positive(0.01, 2), min_size=1, max_size=3))
    height, width = draw(positive(0.5, 5)), draw(positive(0.1, 100))
    segments = []
    for i, length in enumerate(lengths):
        offset = draw(st.floats(0.01, 0.49)) * min(*lengths[: i + 1], height, 1.0)
        below = draw(st.floats(0.01, 0.99)) * (height - offset)
        segments.append(
            {
                "links": draw(st.integers(1, 8)),
                "link": {
                    "length": length,
                    "radius": draw(positive()),
                    **draw(bodies(length)),
                },
                "joint": {
                    "stiffness": draw(st.floats(0, 10)),
                    "damping": draw(st.floats(0, 10)),
                    "limit": draw(st.floats(0.01, 3.14)),
                },
                "cables": {
                    "angles_deg": draw(directions()),
                    "pitch_radius": draw(st.floats(1e-3, 0.49)) * min(width, lengths[0]),
                    "guide_offset": offset,
                },
                "servo": {
                    "mass": draw(positive()),
                    "damping": draw(st.floats(0, 100)),
                    "gain": draw(positive()),
                    "eta": draw(positive()),
                    "radius": draw(st.floats(0.01, 0.99)) * below,
                    "offset": below,
                },
            }
        )
    step = draw(positive(1e-5, 0.1))
    return Robot.model_validate(
        {
            "name": draw(st.from_regex(r"\A[a-z][a-z0-9-]{0,10}\Z")),
            "time_step": step,
            "base": {
                "size": (width, draw(positive(1, 1e3)) * width, height),
                **draw(bodies(width)),
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
    head, _, errors = message.partition(": 12 errors in the robot description: ")
    assert head == "my.toml"
    assert errors.split("; ") == [
        "line 7, base.mass: should be greater than 0 (found -5.0)",
        "line 9, base.inertia: no rigid body has this inertia: 100 exceeds 35 + 40 (the largest "
        "principal moment is at most the sum of the other two) (found [40.0, 35.0, 100.0])",
        "line 19, segments[0].links: should be greater than or equal to 1 (found 0)",
        "line 21, segments[0].link.radius: Field required",
        "line 23, segments[0].link.radus: unknown key, did you mean 'radius'? (found 0.02)",
        "line 30, segments[0].joint.limit: should be a valid number (found '1.5')",
        "line 40, segments[0].servo.gain: should be a finite number (found nan)",
        "line 41, segments[0].servo.eta: should be a valid number (found True)",
        "line 25, segments[0].link.inertia[0]: is more than 0.00578 kg m^2, which 1.18 kg have at "
        "a distance of 0.07 m from their centre (found 0.016)",
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
        (
            "offset = 0.2\n",
            "offset = 0.2\nmas = 1.0\n",
            "line 44, segments[0].servo.mas: unknown key, did you mean 'mass'? (found 1.0)",
        ),
        (
            "[40.0, 35.0, 75.0]",
            "[400.0, 350.0, 600.0]",
            "line 9, base.inertia[2]: is more than 540 kg m^2, which 500 kg have at a distance of "
            "1.04 m from their centre (found 600.0)",
        ),
        (
            "[0.016, 0.016, 0.00037]",
            "[100.0, 100.0, 0.00037]",
            "line 25, segments[0].link.inertia[0]: is more than 0.068 kg m^2, which 1.18 kg have "
            "at a distance of 0.24 m from their centre (found 100.0)",
        ),
        (
            "pitch_radius = 0.02",
            "pitch_radius = 0.31",
            "line 34, segments[0].cables.pitch_radius: puts a cable outside the base: must be at "
            "most 0.3 m (found 0.31)",
        ),
        (
            "[0.0, 90.0, 180.0, 270.0]",
            "[0.0, 360.0, -360.0]",
            "line 33, segments[0].cables.angles_deg: puts all cables at one place",
        ),
        (
            "links = 6",
            "links = 1000000000",
            "line 19, segments[0].links: must lie between 1 and 500 (found 1000000000)",
        ),
        (
            "eta = 5.0",
            "eta = 1e-300",
            "line 41, segments[0].servo.eta: must lie between 1e-09 and 1e+09 (found 1e-300)",
        ),
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
    for other in ("robot.yaml", "robot.json"):
        with pytest.raises(CdcsrError, match=r"Unknown robot .* Or give a path ending in \.toml"):
            load_robot(other)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(PAPER, "utf-8-sig")
    assert load_robot(path) == load_robot("paper")


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 3000 + "]" * 3000,
        "a = " + "9" * 5000,
        "\n".join(f"wing{i} = {i}" for i in range(10_000)),
        "x" * 10_000_000,
        f"name = '{'n' * 200_000}'",
    ],
    ids=["deep", "long integer", "many keys", "long", "long value"],
)
def test_a_bomb_ends_in_a_short_message_soon(text: str) -> None:
    start = time.perf_counter()
    assert len(broken(("time_step", text + "\ntime_step"))) < 2000
    assert time.perf_counter() - start < 3


@pytest.mark.parametrize("kind", ["pipe", "device", "loop", "long name", "folder"])
def test_what_is_no_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "it.toml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "long name":
        path = tmp_path / f"{'n' * 300}.toml"
    else:
        path.mkdir()
    with pytest.raises(CdcsrError, match=r"^Cannot read the robot description "):
        load_robot(path)
