"""The mirror images that a robot has."""

from __future__ import annotations

from typing import Any

import pytest

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.symmetry import images


def _turned(angle: float) -> Robot:
    """Return the paper's robot with all cables turned by an angle, in [degrees]."""
    data = load_robot("paper").model_dump()
    for segment in data["segments"]:
        segment["cables"]["angles_deg"] = [
            angle + other for other in segment["cables"]["angles_deg"]
        ]
    return Robot.model_validate(data)


@pytest.mark.parametrize(
    ("robot", "names"),
    [
        (load_robot("paper"), ["identity", "mirror_x", "mirror_y", "half_turn"]),
        (_turned(10.0), ["identity", "half_turn"]),
        (load_robot("three-cable"), ["identity", "mirror_y"]),
    ],
    ids=["paper", "turned", "three-cable"],
)
def test_images(robot: Robot, names: list[str]) -> None:
    assert [image.name for image in images(robot)] == names


HALF = ["identity", "half_turn"]
ACROSS_X, ACROSS_Y = ["identity", "mirror_y"], ["identity", "mirror_x"]


@pytest.mark.parametrize(
    ("section", "change", "names"),
    [
        ((), {"gravity": (0.1, 0.0, 0.0)}, ACROSS_X),
        ((), {"gravity": (0.0, 0.1, -9.81)}, ACROSS_Y),
        ((), {"gravity": (0.0, 0.0, -9.81)}, ["identity", "mirror_x", "mirror_y", "half_turn"]),
        (("base",), {"position": (0.2, 0.0, 0.0)}, ACROSS_X),
        (("base",), {"position": (0.0, 0.2, 1.0)}, ACROSS_Y),
        (("base",), {"quaternion": (0.6, 0.0, 0.0, 0.8)}, ["identity"]),
        (("segments", 1, "joint"), {"rest": (0.1, 0.0)}, ACROSS_Y),  # bends about x, so along y
        (("segments", 1, "joint"), {"rest": (0.0, 0.1)}, ACROSS_X),
        (("segments", 0, "joint"), {"lower": -0.3}, ["identity"]),
        (("segments", 0, "joint"), {"order": "x", "lower": -0.3}, ACROSS_Y),
    ],
    ids=str,
)
def test_what_breaks_a_symmetry(
    section: tuple[str | int, ...], change: dict[str, object], names: list[str]
) -> None:
    data: Any = load_robot("paper").model_dump()
    place = data
    for key in section:
        place = place[key]
    place |= change
    assert [image.name for image in images(Robot.model_validate(data))] == names


def test_a_twist_survives_only_the_half_turn() -> None:
    """Either mirror turns it round."""
    data = load_robot("paper").model_dump()
    torsion = {"stiffness": 1.0, "damping": 0.1, "limit": 0.5}
    for rest, names in ((0.2, HALF), (0.0, ["identity", "mirror_x", "mirror_y", "half_turn"])):
        data["segments"][1]["joint"]["torsion"] = torsion | {"rest": rest}
        assert [image.name for image in images(Robot.model_validate(data))] == names


def test_passive_segments_and_listed_paths() -> None:
    """A segment without cables breaks nothing; images of paths are not looked for."""
    data = load_robot("paper").model_dump()
    passive = data["segments"][1] | {"cables": None, "servo": None}
    robot = Robot.model_validate(data | {"segments": [passive, data["segments"][0]]})
    assert [image.cables.tolist() for image in images(robot)][1] == [2, 1, 0, 3]
    cables = data["segments"][0]["cables"]
    cables["paths"] = [{"angle_deg": angle} for angle in cables["angles_deg"]]
    assert [image.name for image in images(Robot.model_validate(data))] == ["identity"]


def test_cables_of_one_angle_are_not_mixed_up() -> None:
    data = load_robot("paper").model_dump()
    data["segments"][0]["cables"]["angles_deg"] = [0, 0, 90, 180, 270]
    (only,) = images(Robot.model_validate(data))
    assert only.cables.tolist() == list(range(9))


def test_cables_of_the_papers_images() -> None:
    """The expected order is found by hand: cables 0 to 3 are at 0, 90, 180 and 270 degrees, and
    cables 4 to 7 are at 45, 135, 225 and 315."""
    cables = {image.name: image.cables.tolist() for image in images(load_robot("paper"))}
    assert cables["mirror_x"] == [2, 1, 0, 3, 5, 4, 7, 6]
    assert cables["mirror_y"] == [0, 3, 2, 1, 7, 6, 5, 4]
    assert cables["half_turn"] == [2, 3, 0, 1, 6, 7, 4, 5]
