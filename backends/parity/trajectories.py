"""The commands that engines are compared along: a demonstrator's, and random ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.tasks.catalogue import Reach

Array = NDArray[np.float64]

DEMONSTRATOR, RANDOM = "demonstrator", "random"
_HOLD = 10
"""Steps a random command is held for; changed at every step, the servos' average is all that the arm would feel."""


@dataclass(frozen=True)
class Commands:
    """Command sequences of N episodes side by side."""

    name: str
    values: Array
    """(N, T, C) servo set-points in [m], one for each time step."""
    length: NDArray[np.int64]
    """(N,) steps of each episode; what comes after is not looked at."""

    @property
    def active(self) -> NDArray[np.bool_]:
        """(T, N): whether a step belongs to its episode."""
        return np.arange(self.values.shape[1])[:, None] < self.length


def random_commands(robot: Robot, episodes: int, seed: int, steps: int = Reach.max_steps) -> Commands:
    """Uniform set-points over the whole range, each held for ten steps."""
    eta = np.array([servo.eta for servo in robot.servos])
    draws = -eta * np.random.default_rng(seed).random(
        (episodes, -(-steps // _HOLD), robot.num_cables)
    )
    values = np.repeat(draws, _HOLD, axis=1)[:, :steps]
    return Commands(RANDOM, values, np.full(episodes, steps))
