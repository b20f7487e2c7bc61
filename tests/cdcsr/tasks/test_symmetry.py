"""The mirror images that a robot has."""

from __future__ import annotations

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
