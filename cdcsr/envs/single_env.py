"""The Gymnasium environment of one robot at a task, over any engine."""

from __future__ import annotations

from copy import deepcopy
from typing import Unpack

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from cdcsr.envs.gym_env import Array, Info, TaskVectorEnv
from cdcsr.envs.options import EnvOptions, read_reset_options
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.simulation.arguments import as_floats
from cdcsr.simulation.cameras import camera_angles


class TaskEnv(gym.Env[Array, Array]):
    """One robot at a task: :class:`TaskVectorEnv` with one copy and no autoreset.

    ``gymnasium.make("cdcsr/Reach-v0", ...)`` makes one; Capture and Follow have the same
    arguments. ``reset(options={"target": (x, y, z)})`` sets where the target begins, in [m],
    instead of drawing it.

    Args:
        render_mode: "rgb_array", whose pictures :meth:`render` returns; "human", whose pictures
            appear in a window after every step; or None.
        camera: the view, a name in :data:`cdcsr.simulation.cameras.CAMERAS`.
        options: see :class:`EnvOptions`.

    Raises:
        CdcsrError: a name is unknown, a number is out of range, or "human" lacks pygame.
    """

    metadata: Info = {  # noqa: RUF012 (Gymnasium's name and type)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 50,
    }

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "side",
        **options: Unpack[EnvOptions],
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise CdcsrError(
                unknown_choice("render_mode", render_mode, self.metadata["render_modes"])
            )
        camera_angles(camera)
        self.render_mode, self.camera = render_mode, camera
        self._window = Window() if render_mode == "human" else None
        self.batch = TaskVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **options)
        self.observation_space = deepcopy(self.batch.single_observation_space)
        self.action_space = deepcopy(self.batch.single_action_space)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Begin a new episode; see :meth:`TaskVectorEnv.reset`."""
        super().reset(seed=seed)
        given = read_reset_options(options, target=(3,))
        targets = {"targets": given["target"][None]} if given else None
        observation, info = self.batch.reset(seed=seed, options=targets)
        self._show()
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
        self._show()
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(info),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture with the target, shape (height, width, 3), if the mode is "rgb_array".

        Raises:
            CdcsrError: the engine cannot draw here.
        """
        return self._picture() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Release what the engine holds, and close the window."""
        self.batch.close()
        if self._window is not None:
            self._window.close()

    def _picture(self) -> NDArray[np.uint8]:
        return self.batch.simulation.render(0, self.camera, self.batch.targets[0])

    def _show(self) -> None:
        """Show the robot in the window, if there is one."""
        if self._window is not None:
            self._window.show(self._picture(), self.metadata["render_fps"])


class Window:
    """A window that shows pictures, for the render mode "human".

    Raises:
        CdcsrError: pygame is not installed, or there is no display.
    """

    def __init__(self) -> None:
        try:
            import pygame
        except ImportError:
            raise CdcsrError(
                "render_mode 'human' needs pygame, which is not installed; run: "
                "pip install 'cdcsr[render]'"
            ) from None
        self._pygame, self._screen, self._clock = pygame, None, pygame.time.Clock()

    def show(self, picture: NDArray[np.uint8], rate: float) -> None:
        """Show a picture, shape (height, width, 3); wait so that there are `rate` a second."""
        pygame = self._pygame
        if self._screen is None:
            try:
                pygame.display.init()
                self._screen = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
            except pygame.error as error:
                raise CdcsrError(
                    f"There is no display for render_mode 'human' ({error}); use 'rgb_array'."
                ) from None
        self._screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()  # else the desktop takes the window for dead
        self._clock.tick(rate)
        pygame.display.flip()

    def close(self) -> None:
        """Close the window; to close twice does nothing."""
        self._pygame.display.quit()
        self._screen = None


def _first(info: Info) -> Info:
    """Return the info of the only copy."""
    return {name: rows[0].item() for name, rows in info.items()}
