"""Following a target that moves (BATD3 paper, section V-F and Fig. 6), and what the base does meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs import EPISODE_STEPS, ReachVectorEnv
from cdcsr.robot import Robot
from controllers.controller import Controller
from training.evaluation import TEST_SEED

Array = NDArray[np.float64]

REST_STEPS = EPISODE_STEPS
"""Simulation steps in which the target rests, for the tip to reach it."""
MOVE_STEPS = 2 * EPISODE_STEPS
"""Simulation steps in which it moves."""
KEEP_EVERY = 25
"""Of these steps, one is kept."""
MOTIONS = ("down", "circle")
DOWN_SPEED = 0.1
"""[m/s]; the paper's target goes straight down, at a speed it does not tell."""
CIRCLE_RADIUS, CIRCLE_PERIOD = 0.05, 1.25
"""[m] and [s]; horizontal, so that its speed is 0.25 m/s."""


@dataclass(frozen=True)
class Following:
    """One sample of one episode."""

    motion: str
    episode: int
    step: int
    """Simulation steps from the start; the target moves after the first :data:`REST_STEPS`."""
    tip_error: float
    """From tip to target, in [m]."""
    base_position_error: float
    """From where the base started, in [m]."""
    base_attitude_error: float
    """Angle from how the base stood at the start, in [rad]."""


def displacement(motion: str, time: float) -> Array:
    """Where a target is, from where it rested, after moving for `time` in [s]; shape (3,), in [m]."""
    if motion == "down":
        return np.array([0.0, 0.0, -DOWN_SPEED * time])
    angle = 2 * np.pi * time / CIRCLE_PERIOD
    return CIRCLE_RADIUS * np.array([np.cos(angle) - 1, np.sin(angle), 0.0])


def follow(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    motion: str,
    episodes: int,
    centers: Array | None = None,
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
    steps = REST_STEPS + MOVE_STEPS
    env = ReachVectorEnv(
        episodes, robot, backend, space,
        frame_skip=frame_skip, max_steps=steps, centers=centers, autoreset_mode="Disabled",
    )  # fmt: skip
    try:
        observation, _ = env.reset(seed=TEST_SEED)
        rest, active = env.targets.copy(), np.ones(episodes, dtype=np.bool_)
        start = env.simulation.state()
        for step in range(frame_skip, steps + 1, frame_skip):
            env.targets = rest + displacement(motion, max(0, step - REST_STEPS) * robot.time_step)
            observation, *_, info = env.step(controller.act(env, observation, active))
            if step % KEEP_EVERY < frame_skip:
                state = env.simulation.state()
                moved = np.linalg.norm(state.base_position - start.base_position, axis=1)
                turned = attitude_error(state.base_quaternion, start.base_quaternion)
                for i in range(episodes):
                    yield Following(motion, i, step, float(info["distance"][i]), float(moved[i]), float(turned[i]))
    finally:
        env.close()


def attitude_error(quaternion: Array, reference: Array) -> Array:
    """Angle between attitudes, quaternions of shape (num, 4), in [rad], from 0 to pi."""
    return 2 * np.arccos(np.clip(np.abs((quaternion * reference).sum(axis=1)), 0, 1))
