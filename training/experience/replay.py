"""A replay buffer of whole episodes; n-step returns are computed when an episode is stored."""

from __future__ import annotations

from itertools import accumulate
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


class Batch(NamedTuple):
    """B transitions, each over up to n actions."""

    observation: Tensor
    """(B, observation size)."""
    action: Tensor
    """(B, C), in [-1, 1]."""
    reward: Tensor
    """(B,), the discounted sum of the rewards from observation to next observation."""
    discount: Tensor
    """(B,), the weight of the value at the next observation: gamma^steps, or 0 after success."""
    next_observation: Tensor
    """(B, observation size)."""
    bc_action: Tensor
    """(B, C), the behaviour clone's action at the observation, in [-1, 1]."""
    next_bc_action: Tensor
    """(B, C), the behaviour clone's action at the next observation, in [-1, 1]."""
    outcome: Tensor
    """(B,), the discounted sum of the rewards from the observation to the end of the episode."""


class Replay:
    """A ring of rows, one for each observation; an episode of T actions takes T + 1 in sequence.

    The last row of an episode begins no transition; it is only the successor of others. Rows are
    overwritten in the order in which they came, so a row's successor exists as long as the row.

    Args:
        capacity: number of rows.
        observation_size, action_size: widths.
        discount: gamma.
        return_steps: n.
    """

    def __init__(
        self,
        capacity: int,
        observation_size: int,
        action_size: int,
        discount: float,
        return_steps: int,
    ) -> None:
        self.capacity, self.discount, self.return_steps = capacity, discount, return_steps
        # The arrays are made at full size; the system gives memory only to pages that are written.
        self.rows = {
            "observation": np.zeros((capacity, observation_size), np.float32),
            "action": np.zeros((capacity, action_size), np.float32),
            "bc_action": np.zeros((capacity, action_size), np.float32),
            "reward": np.zeros(capacity, np.float32),
            "discount": np.zeros(capacity, np.float32),
            "outcome": np.zeros(capacity, np.float32),
            "successor": np.full(capacity, -1, np.int64),
        }
        self.position = 0
        self.size = 0

    def add_episode(
        self,
        observations: Array,
        actions: Array,
        rewards: Array,
        terminated: bool,
        bc_actions: NDArray[np.floating] | None = None,
    ) -> None:
        """Store an episode of T actions.

        Args:
            observations: shape (T + 1, observation size).
            actions: shape (T, C), in [-1, 1].
            rewards: shape (T,).
            terminated: the episode ended by success; otherwise its end is bootstrapped.
            bc_actions: the behaviour clone's action at each observation, shape (T + 1, C).
        """
        length = len(actions)
        returns, ends = n_step_returns(rewards, self.discount, self.return_steps)
        at = (self.position + np.arange(length + 1)) % self.capacity
        rows = self.rows
        rows["observation"][at] = observations
        rows["action"][at[:-1]] = actions
        if bc_actions is not None:
            rows["bc_action"][at] = bc_actions
        rows["reward"][at[:-1]] = returns
        weight = self.discount ** (ends - np.arange(length))
        rows["discount"][at[:-1]] = np.where((ends == length) & terminated, 0, weight)
        rows["outcome"][at[:-1]] = returns_to_go(rewards, self.discount)
        rows["successor"][at[:-1]] = at[ends]
        rows["successor"][at[-1]] = -1
        self.position = int((self.position + length + 1) % self.capacity)
        self.size = min(self.size + length + 1, self.capacity)

    def sample(self, batch_size: int, rng: np.random.Generator) -> Batch:
        """Draw transitions uniformly, with replacement."""
        rows = self.rows
        chosen = rng.integers(self.size, size=batch_size)
        successor = rows["successor"][chosen]
        # The last row of an episode begins no transition: draw again.
        while (last := successor < 0).any():
            chosen[last] = rng.integers(self.size, size=int(last.sum()))
            successor = rows["successor"][chosen]
        return Batch(
            observation=torch.from_numpy(rows["observation"][chosen]),
            action=torch.from_numpy(rows["action"][chosen]),
            reward=torch.from_numpy(rows["reward"][chosen]),
            discount=torch.from_numpy(rows["discount"][chosen]),
            next_observation=torch.from_numpy(rows["observation"][successor]),
            bc_action=torch.from_numpy(rows["bc_action"][chosen]),
            next_bc_action=torch.from_numpy(rows["bc_action"][successor]),
            outcome=torch.from_numpy(rows["outcome"][chosen]),
        )


def returns_to_go(rewards: Array, discount: float) -> Array:
    """Return the discounted sum of the rewards from each action to the last: (T,) -> (T,)."""
    backwards = accumulate(
        reversed(rewards.tolist()), lambda later, reward: reward + discount * later
    )
    return np.array([*backwards])[::-1]


def n_step_returns(rewards: Array, discount: float, steps: int) -> tuple[Array, NDArray[np.int64]]:
    """Return the discounted sums of up to n rewards, and where each of them ends.

    Args:
        rewards: shape (T,).
        discount: gamma.
        steps: n.

    Returns:
        The sums of gamma^k r_{t+k} for k < min(n, T - t), shape (T,); and min(t + n, T), shape
        (T,).
    """
    length = len(rewards)
    padded = np.concatenate([rewards, np.zeros(steps)])
    sums = sum((discount**k * padded[k : k + length] for k in range(steps)), np.zeros(length))
    return sums, np.minimum(np.arange(length) + steps, length)
