"""The commands under which engines are compared: a demonstrator's, and random ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array
from cdcsr.tasks.catalogue import Reach

DEMONSTRATOR, RANDOM = "demonstrator", "random"
_HOLD = 10
"""Each random command is held for this many steps. If it changed in every step, the servos would
average over the commands, and the arm would hardly move."""


@dataclass(frozen=True)
class Commands:
    """The command sequences of N episodes side by side."""

    name: str
    values: Array
    """Servo set-points in [m], one for each time step, shape (N, T, C)."""
    length: NDArray[np.int64]
    """How many steps each episode has, shape (N,); later commands are ignored."""

    @property
    def active(self) -> NDArray[np.bool_]:
        """Whether a step belongs to its episode, shape (T, N)."""
        return np.arange(self.values.shape[1])[:, None] < self.length


def random_commands(
    robot: Robot, episodes: int, seed: int, steps: int = Reach.max_steps
) -> Commands:
    """Draw set-points that are uniform over the whole range, each held for ten steps."""
    draws = robot.full_commands * np.random.default_rng(seed).random(
        (episodes, -(-steps // _HOLD), robot.num_cables)
    )
    values = np.repeat(draws, _HOLD, axis=1)[:, :steps]
    return Commands(RANDOM, values, np.full(episodes, steps))
