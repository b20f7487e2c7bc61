"""Measure how a controller follows a moving target (BATD3 paper, section V-F and Fig. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from controllers.controller import Controller
from controllers.rollout import rollout
from training.config.seeds import TEST_SEED

MOTIONS = ("line", "circle", "random")
KEEP_EVERY = 25
"""One sample is kept of so many actions."""


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
    frame_skip: int | None = None,
) -> list[Following]:
    """Let a controller follow targets that start where the held-out targets are.

    Args:
        controller: the controller that acts.
        robot: the description.
        backend: the engine.
        space: the operation space in which targets start.
        motion: one of :data:`MOTIONS`.
        episodes: how many, run as one batch.
        centers: the demonstrations' targets, shape (n, 3), for Floating and Spatter.
        frame_skip: how many simulation steps each action is held for; by default the robot's own
            number.
    """
    skip = ruler(robot).frame_skip if frame_skip is None else frame_skip
    samples: list[Following] = []
    lost = np.zeros(episodes, dtype=bool)

    def watch(action: int, info: Mapping[str, NDArray[np.float64]]) -> None:
        np.logical_or(lost, info.get("diverged", False), out=lost)
        if action % KEEP_EVERY == 0:
            names = ("distance", "base_position_error", "base_attitude_error")
            for i, row in enumerate(np.stack([info[name] for name in names], axis=1).tolist()):
                if not lost[i]:
                    samples.append(Following(motion, i, action * skip, *row))

    env = TaskVectorEnv(
        episodes,
        robot,
        backend,
        space,
        frame_skip=skip,
        centers=centers,
        task=f"follow-{motion}",
        autoreset_mode="Disabled",
    )
    try:
        observation, _ = env.reset(seed=TEST_SEED)
        rollout(controller, env, observation, watch)
        if lost.any():
            print(f"{lost.sum()} of {episodes} episodes diverged in {backend} and end there")
        return samples
    finally:
        env.close()
