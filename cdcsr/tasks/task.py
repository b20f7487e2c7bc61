"""The contract of a task: when its episodes succeed, and what an action is worth.

A task holds no state. What it has to count during an episode is handed to it as :data:`Counts`.
It judges arrays of every library that follows the Python array API: a learner on a graphics card
passes tensors of PyTorch where the types say NumPy.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import rounded, ruler
from cdcsr.simulation.arguments import check_count
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import DISTANCE
from cdcsr.tasks.target_motion import MotionName, make_motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Counts = dict[str, NDArray[np.int64]]
"""The counts that a task keeps of an episode, by name; shape (num,), all zero at its beginning."""
Reward = Literal["sparse", "dense"]
_MOST_STEPS = 10_000_000
BASE_SHIFT, BASE_TILT = 0.003, 0.05
"""The largest distance of a quiet base from its start, in [m] and [rad], for the paper's robot. The
paper reports these values for its Fig. 6."""


class Verdict(NamedTuple):
    """How the episodes stand after an action; each field has the shape (num,)."""

    on_target: Mask
    """Whether the tip is where it should be at this moment."""
    success: Mask
    terminated: Mask
    """Whether success has ended the episode."""
    rewarded: Mask
    """Where the sparse reward is 1."""

    def without(self, lost: Mask) -> Verdict:
        """Return the verdict with nothing achieved by some copies."""
        return Verdict(*(rows & ~lost for rows in self))


@dataclass(frozen=True)
class Task(ABC):
    """Something to do with a target in one episode.

    What is observed is the same in all tasks: see :mod:`cdcsr.tasks.observation`.
    """

    threshold: float = 0.03
    """The tip is on the target within this distance, in [m]."""
    reward_kind: Reward = "sparse"
    """sparse: eq. (2) of the BATD3 paper. dense: the negative distance in [m], plus 1 where the
    sparse reward is 1."""
    motion: MotionName = "rest"
    """How the target moves: a name in :data:`cdcsr.tasks.target_motion.MOTIONS`."""
    quiet: bool = False
    """The tip is on the target only while the base is within `base_shift` and `base_tilt` of its
    start."""
    max_steps: int = 250
    """An episode is truncated after this many simulation steps."""
    period: float = 0.0025
    """The time from one action to the next, in [s]; an environment sets its own."""
    own_threshold: float = 0.03
    """The robot's own threshold, which the name leaves out, in [m]."""
    base_shift: float = BASE_SHIFT
    """In [m]."""
    base_tilt: float = BASE_TILT
    """In [rad]."""
    size: float = 1.0
    """All lengths of the target's motion are multiplied by it."""
    pace: float = 1.0
    """All times of the target's motion are multiplied by it."""

    kind: ClassVar[str]
    ends: ClassVar[bool] = True
    """Whether success ends the episode."""
    count_names: ClassVar[tuple[str, ...]] = ()
    """The names of its :data:`Counts`."""

    def __post_init__(self) -> None:
        if self.reward_kind not in get_args(Reward):
            raise CdcsrError(f"reward must be 'sparse' or 'dense', not {self.reward_kind!r}.")
        if not 0 < self.threshold < math.inf:
            raise CdcsrError(f"threshold must be positive and finite, not {self.threshold:g}.")
        check_count("max_steps", self.max_steps, _MOST_STEPS)
        make_motion(self.motion)

    @property
    def name(self) -> str:
        """The name made of kind, motion, quietness and threshold; two tasks with the same name
        have the same episodes."""
        parts = [
            self.kind,
            *([self.motion] if self.motion != "rest" else []),
            *(["quiet"] if self.quiet else []),
        ]
        if self.threshold == rounded(self.own_threshold / 3, 12):
            parts.append("precise")
        elif self.threshold != self.own_threshold:
            parts.append(f"{1e3 * self.threshold:g}mm")
        name = "-".join(parts)
        return {"reach-quiet": "quiet", "reach-precise": "precise"}.get(name, name)

    def of(self, robot: Robot) -> Self:
        """Return this task of the paper's robot with another robot's own numbers."""
        own = ruler(robot)
        seconds = own.seconds * (self.max_steps / Task.max_steps)
        return replace(
            self,
            threshold=rounded(own.threshold * (self.threshold / Task.threshold), 12),
            own_threshold=own.threshold,
            base_shift=own.base_shift,
            base_tilt=own.base_tilt,
            max_steps=max(1, round(seconds / robot.time_step)),
            size=own.size,
            pace=own.pace,
        )

    def new_counts(self, num: int) -> Counts:
        """Return the counts of `num` episodes that begin."""
        return {name: np.zeros(num, np.int64) for name in self.count_names}

    def judge(
        self,
        state: State,
        target_velocity: Array,
        distance: Array,
        counts: Counts,
        count: bool = True,
    ) -> Verdict:
        """Return how the episodes stand, and update `counts`.

        Args:
            state: the measured state of num copies.
            target_velocity: shape (num, 3), in [m/s].
            distance: from tip to target, shape (num,), in [m].
            counts: those of the episodes.
            count: whether an action was taken; if not, `counts` stays as it is.
        """
        speed = state.tip_velocity - target_velocity
        on_target = self.on_target(distance, speed, state.base_position, state.base_quaternion)
        if count:
            self._count(on_target, counts)
        return self._verdict(on_target, counts)

    def on_target(
        self,
        distance: Array,
        relative_velocity: Array,
        base_position: Array,
        base_quaternion: Array,
    ) -> Mask:
        """Return whether the tip is where it should be at one moment, shape (n,).

        Args:
            distance: from tip to target, shape (n,), in [m].
            relative_velocity: of the tip relative to the target, shape (n, 3), in [m/s].
            base_position: shape (n, 3), in [m].
            base_quaternion: w-x-y-z, shape (n, 4).
        """
        near = distance <= self.threshold
        if self.quiet:
            shift, tilt = base_errors(base_position, base_quaternion)
            near &= (shift <= self.base_shift) & (tilt <= self.base_tilt)
        return near & self._is_slow(relative_velocity)

    def _is_slow(self, relative_velocity: Array) -> Mask:
        """Return whether the tip is slow enough to be on the target, shape (n,); here always."""
        xp = array_namespace(relative_velocity)
        return xp.ones_like(relative_velocity[:, 0], dtype=xp.bool)

    @abstractmethod
    def _count(self, on_target: Mask, counts: Counts) -> None:
        """Update the counts after an action."""

    @abstractmethod
    def _verdict(self, on_target: Mask, counts: Counts) -> Verdict:
        """Return how the episodes stand, given the updated counts."""

    def reward(self, distance: Array, rewarded: Mask) -> Array:
        """Return the rewards, shape (num,), from the distances in [m] and :class:`Verdict`."""
        paid: Array = array_namespace(distance).astype(rewarded, distance.dtype)
        if self.reward_kind == "sparse":
            return paid
        return paid - distance

    def extra_info(self, state: State, counts: Counts) -> dict[str, Array]:
        """Return the entries of `info` that only this task has, each of shape (num,)."""
        return {}

    def episode_rewards(self, observations: Array, success: bool) -> Array:
        """Return the rewards of a recorded episode of T actions, shape (T,).

        Args:
            observations: shape (T + 1, observation size); the last one follows the last action.
            success: whether the last action brought success.
        """
        ended = np.zeros(len(observations) - 1, dtype=bool)
        ended[-1] = success
        return self.reward(observations[1:, DISTANCE], ended)

    def first_success(
        self,
        tip_position: Array,
        tip_velocity: Array,
        target: Array,
        base_position: Array | None = None,
        base_quaternion: Array | None = None,
    ) -> int | None:
        """Return after how many actions a recorded episode succeeds with another target, at rest.

        Args:
            tip_position: before each of T actions and after the last, shape (T + 1, 3), in [m].
            tip_velocity: shape (T + 1, 3), in [m/s].
            target: shape (3,), in [m].
            base_position: shape (T + 1, 3), in [m]; only a quiet task needs it.
            base_quaternion: w-x-y-z, shape (T + 1, 4); only a quiet task needs it.

        Returns:
            A number from 1 to T, or None if the episode does not succeed.

        Raises:
            ValueError: a quiet task lacks the base.
        """
        if base_position is None or base_quaternion is None:
            if self.quiet:
                raise ValueError("A quiet task needs the base's positions and quaternions.")
            base_position = np.zeros((len(tip_position), 3))
            base_quaternion = np.zeros((len(tip_position), 4))
        distance = np.linalg.norm(tip_position - target, axis=1)
        on_target = self.on_target(distance, tip_velocity, base_position, base_quaternion)
        return int(self.first_successes(on_target[None, 1:])[0]) or None

    def first_successes(self, on_target: Mask) -> NDArray[np.int64]:
        """Return after how many actions episodes succeed, shape (n,); 0 where they do not.

        Args:
            on_target: whether the tip was on target after each action, shape (n, T).
        """
        xp = array_namespace(on_target)
        first = xp.sum(on_target, axis=1, dtype=xp.int64) * 0
        counts = {name: xp.zeros_like(first) for name in self.count_names}
        for action in range(on_target.shape[1]):
            self._count(on_target[:, action], counts)
            success = self._verdict(on_target[:, action], counts).success & (first == 0)
            first = first + (action + 1) * success
        return first


def base_errors(position: Array, quaternion: Array) -> tuple[Array, Array]:
    """Return how far the base is from its start: distance in [m] and angle in [rad], shape (n,).

    Args:
        position: shape (n, 3), in [m].
        quaternion: w-x-y-z, shape (n, 4), unit length.
    """
    xp = array_namespace(position)
    vector, scalar = xp.linalg.vector_norm(quaternion[:, 1:], axis=1), abs(quaternion[:, 0])
    angle: Array = 2 * xp.atan2(vector, scalar)
    return xp.linalg.vector_norm(position, axis=1), angle
