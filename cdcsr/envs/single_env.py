"""The Gymnasium environment of one robot at a task, over any engine."""

from __future__ import annotations

from typing import Unpack

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from cdcsr.envs.gym_env import Array, Info, TaskVectorEnv
from cdcsr.envs.options import EnvOptions, read_reset_options
from cdcsr.simulation.arguments import as_floats


class TaskEnv(gym.Env[Array, Array]):
    """One robot at a task: :class:`TaskVectorEnv` with one copy and no autoreset.

    ``gymnasium.make("cdcsr/Reach-v0", ...)`` makes one; Capture and Follow have the same
    arguments. ``reset(options={"target": (x, y, z)})`` sets where the target begins, in [m],
    instead of drawing it.

    Args:
        render_mode: "rgb_array" or None.
        options: see :class:`EnvOptions`.
    """

    metadata: Info = {  # noqa: RUF012 (Gymnasium's name and type)
        "render_modes": ["rgb_array"],
        "render_fps": 50,
    }

    def __init__(self, render_mode: str | None = None, **options: Unpack[EnvOptions]) -> None:
        self.render_mode = render_mode
        self.batch = TaskVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **options)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Begin a new episode; see :meth:`TaskVectorEnv.reset`."""
        super().reset(seed=seed)
        given = read_reset_options(options, target=(3,))
        targets = {"targets": given["target"][None]} if given else None
        observation, info = self.batch.reset(seed=seed, options=targets)
        return observation[0], _first(info)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Advance the robot by one action, shape (C,); see :meth:`TaskVectorEnv.step`.

        Raises:
            Diverged: the robot left the range in which its numbers mean anything.
        """
        row = as_floats("action", action, self.action_space.shape or ())[None]
        observation, reward, terminated, truncated, info = self.batch.step(row)
        if self.batch.divergence is not None:
            raise self.batch.divergence
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(info),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture with the target, shape (height, width, 3), if the mode asks for it."""
        if self.render_mode != "rgb_array":
            return None
        return self.batch.simulation.render(0, target=self.batch.targets[0])

    def close(self) -> None:
        """Release what the engine holds."""
        self.batch.close()


def _first(info: Info) -> Info:
    """Return the info of the only copy."""
    return {name: rows[0].item() for name, rows in info.items()}
