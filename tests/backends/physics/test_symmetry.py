"""The image of what a robot does is what its image does, in every engine; and the images that a
robot has."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.observation import DISTANCE, TARGET, TIP_POSITION
from cdcsr.tasks.symmetry import images

_ACTIONS, _HOLD = 120, 10


def test_what_the_image_does(engine: str, robot: Robot) -> None:
    """The image of each command leads to the image of each observation: tip, base, its turning,
    sliders, and speeds."""
    known = images(robot)
    env = TaskVectorEnv(len(known), robot, engine, autoreset_mode="Disabled")
    rng = np.random.default_rng(0)
    eta = np.array([servo.eta for servo in robot.servos])
    command, moved = -eta, np.zeros(3)
    start, _ = env.reset(seed=0)
    for action in range(_ACTIONS):
        if action % _HOLD == 0:
            command = -eta * rng.random(robot.num_cables) * (rng.random(robot.num_cables) > 0.5)
        observation, *_ = env.step(np.array([image.command(command) for image in known]))
        moved = np.maximum(moved, np.abs(observation[0] - start[0])[TIP_POSITION])
        for image, seen in zip(known, observation, strict=True):
            expected = image.observation(observation[0])
            expected[TARGET], expected[DISTANCE] = (
                seen[TARGET],
                seen[DISTANCE],
            )  # each copy has a target of its own
            np.testing.assert_allclose(seen, expected, atol=1e-7, err_msg=image.name)
    env.close()
    assert moved[:2].min() > 0.01  # it was bent both ways


def _turned(angle: float) -> Robot:
    """The paper's robot with all cables further round."""
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
    """By hand: cables 0 to 3 are at 0, 90, 180 and 270 degrees, 4 to 7 at 45, 135, 225 and 315."""
    cables = {image.name: image.cables.tolist() for image in images(load_robot("paper"))}
    assert cables["mirror_x"] == [2, 1, 0, 3, 5, 4, 7, 6]
    assert cables["mirror_y"] == [0, 3, 2, 1, 7, 6, 5, 4]
    assert cables["half_turn"] == [2, 3, 0, 1, 6, 7, 4, 5]
