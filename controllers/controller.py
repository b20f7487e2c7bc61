"""The contract of a controller."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv

Array = NDArray[np.float64]


class Controller(ABC):
    """Chooses commands for a batch of robots, one call for all of them."""

    name: str

    @abstractmethod
    def act(self, env: TaskVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
        """Commands for the next control step.

        Args:
            env: the robots; a model-based controller asks its simulation for dynamics.
            observation: what a policy may see, shape (num, 23 + C).
            active: copies whose command matters, shape (num,); the rest may be left at anything valid.

        Returns:
            Servo set-points, shape (num, C), in [-eta, 0] m.
        """
