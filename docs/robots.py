"""Draw all shipped robots, each with its tip in the middle of its targets:
`python docs/robots.py docs/robots.png`."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from backends.viewers.software import Renderer
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.plots import INK
from cdcsr.robot.colors import BACKGROUND
from cdcsr.robot.description import load_robot, shipped_robots
from controllers.jacobian import JacobianController
from controllers.rollout import rollout

_COLUMNS, _WIDTH, _HEIGHT, _LINE = 4, 200, 290, 20
"""Panels in a row; width and height of a panel, and height of its title, in pixels."""


def panel(name: str) -> NDArray[np.uint8]:
    """Return the picture of a robot that the demonstrator has brought to its target."""
    robot = load_robot(name)
    with closing(TaskVectorEnv(1, robot, autoreset_mode="Disabled")) as env:
        target = np.array([robot.workspace.center])
        observation, _ = env.reset(options={"targets": target})
        rollout(JacobianController(robot), env, observation)
        position = env.simulation.get_snapshot().position[0]
    with closing(Renderer(robot)) as renderer:
        return renderer.draw(position, targets=target, size=(_HEIGHT - _LINE, _WIDTH))


def main(path: Path) -> None:
    """Write the picture, in 256 colours."""
    names = shipped_robots()
    rows = -(-len(names) // _COLUMNS)
    image = Image.new("RGB", (_COLUMNS * _WIDTH, rows * _HEIGHT), BACKGROUND)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(12)
    for number, name in enumerate(names):
        row, column = divmod(number, _COLUMNS)
        left, top = column * _WIDTH, row * _HEIGHT
        title = f"{name}, {load_robot(name).arm_length:g} m"
        draw.text((left + _WIDTH // 2, top + 4), title, INK, font, anchor="ma")
        image.paste(Image.fromarray(panel(name)), (left, top + _LINE))
    image.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
