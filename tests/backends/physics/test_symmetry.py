"""The image of what a robot does is what its image does, in every engine; and the images that a
robot has."""

from __future__ import annotations

import numpy as np

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.tasks.observation import DISTANCE, TARGET, TIP_POSITION
from cdcsr.tasks.symmetry import images

_ACTIONS, _HOLD = 120, 10


def test_mirrored_commands_give_the_mirrored_motion(engine: str, robot: Robot) -> None:
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
            # Each copy has a target of its own.
            expected[TARGET], expected[DISTANCE] = seen[TARGET], seen[DISTANCE]
            np.testing.assert_allclose(seen, expected, atol=1e-7, err_msg=image.name)
    env.close()
    assert moved[:2].min() > 0.005  # it was bent both ways
