"""What the robot is asked to do, as functions of State: observation, reward, success."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot import Robot
from cdcsr.simulation import State

Array = NDArray[np.float64]
Reward = Literal["sparse", "dense"]


@dataclass(frozen=True)
class Reach:
    """Bring the tip within a threshold of a target, fast or slow (BATD3 paper, section III-A).

    The observation is eq. (1): tip position and velocity, target, distance, base position, quaternion
    (w-x-y-z), velocity and angular velocity, and cable travel; world frame, SI units.
    """

    threshold: float = 0.03
    """Success within this distance, in [m]."""
    reward_kind: Reward = "sparse"
    """sparse: eq. (2). dense: minus the distance in [m], plus 1 on success."""

    def __post_init__(self) -> None:
        if self.reward_kind not in get_args(Reward):
            raise CdcsrError(f"reward must be 'sparse' or 'dense', not {self.reward_kind!r}.")

    def distance(self, state: State, target: Array) -> Array:
        """From tip to target, shape (num,), in [m]."""
        apart = target - state.tip_position
        return np.sqrt(np.einsum("ni,ni->n", apart, apart))

    def parts(self, state: State, target: Array, distance: Array) -> dict[str, Array]:
        """The parts of eq. (1) by name, in its order, each of shape (num, ...)."""
        return {
            "tip_position": state.tip_position,
            "tip_velocity": state.tip_velocity,
            "target": target,
            "distance": distance[:, None],
            "base_position": state.base_position,
            "base_quaternion": state.base_quaternion,
            "base_velocity": state.base_velocity,
            "base_angular_velocity": state.base_angular_velocity,
            "cable_travel": state.cable_travel,
        }

    def observe(self, state: State, target: Array, distance: Array) -> Array:
        """Eq. (1), shape (num, 23 + C)."""
        return np.concatenate(list(self.parts(state, target, distance).values()), axis=1)

    def reward(self, distance: Array, success: NDArray[np.bool_]) -> Array:
        """Shape (num,)."""
        if self.reward_kind == "sparse":
            return success.astype(np.float64)
        return success - distance


BASE_POSITION = slice(10, 13)
"""Where the base's position is in the observation."""


def observation_size(robot: Robot) -> int:
    """Length of eq. (1)."""
    return 23 + robot.num_cables


def actions_per_episode(max_steps: int, frame_skip: int) -> int:
    """How many actions, each held for `frame_skip` simulation steps, fit into `max_steps`.

    Raises:
        CdcsrError: not even one fits, or it would not be held for a step.
    """
    if not 1 <= frame_skip <= max_steps:
        raise CdcsrError(f"frame_skip must be between 1 and max_steps ({max_steps}), not {frame_skip}.")
    return max_steps // frame_skip
