"""Following a target that moves (BATD3 paper, section V-F and Fig. 6), and what the base does meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from controllers.controller import Controller
from training.config.seeds import TEST_SEED

MOTIONS = ("line", "circle", "random")
KEEP_EVERY = 25
"""Of these actions, one is kept."""


class Following(NamedTuple):
    """One sample of one episode."""

    motion: str
    episode: int
    step: int
    """Simulation steps from the start."""
    tip_error: float
    """From tip to target, in [m]."""
    base_position_error: float
    """From where the base started, in [m]."""
    base_attitude_error: float
    """Angle from how the base stood at the start, in [rad]."""


def follow(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    motion: str,
    episodes: int,
    centers: NDArray[np.float64] | None = None,
    frame_skip: int = 1,
) -> Iterator[Following]:
    """Have a controller follow targets that start where the held-out ones lie.

    Args:
        controller: it sees where the target is, as in reaching, and not how it moves.
        robot: the description.
        backend: the engine.
        space: where targets start.
        motion: one of :data:`MOTIONS`.
        episodes: how many, run as one batch.
        centers: the demonstrations' targets, shape (n, 3), for Floating and Spatter.
        frame_skip: simulation steps each action is held for.
    """
    env = TaskVectorEnv(
        episodes,
        robot,
        backend,
        space,
        frame_skip=frame_skip,
        centers=centers,
        task=f"follow-{motion}",
        autoreset_mode="Disabled",
    )
    try:
        observation, _ = env.reset(seed=TEST_SEED)
        active = np.ones(episodes, dtype=np.bool_)
        for action in range(1, env.max_actions + 1):
            observation, *_, info = env.step(controller.act(env, observation, active))
            if action % KEEP_EVERY == 0:
                errors = (
                    info[name]
                    for name in ("distance", "base_position_error", "base_attitude_error")
                )
                for i, row in enumerate(np.stack(list(errors), axis=1).tolist()):
                    yield Following(motion, i, action * frame_skip, *row)
    finally:
        env.close()
