"""The contract of a task: what is seen, how it is going, and what that is worth, as functions of State."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import DISTANCE
from cdcsr.tasks.target_motion import MotionName, make_motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Memory = dict[str, NDArray[np.int64]]
"""What a task remembers of the episode of each copy: counts of shape (num,), all zero when it begins."""
Reward = Literal["sparse", "dense"]
BASE_SHIFT, BASE_TILT = 0.003, 0.05
"""How far a quiet base may be from its start, in [m] and [rad]: what the paper reports for Fig. 6."""


class Verdict(NamedTuple):
    """How things stand after an action, each of shape (num,)."""

    on_target: Mask
    """Whether the tip is where it should be at this moment."""
    success: Mask
    terminated: Mask
    rewarded: Mask
    """Where the sparse reward is 1."""


@dataclass(frozen=True)
class Task(ABC):
    """Something to do with a target, in one episode.

    What is observed is the same in every task: see :mod:`cdcsr.tasks.observation`.
    """

    threshold: float = 0.03
    """The tip is on the target within this distance, in [m]."""
    reward_kind: Reward = "sparse"
    """sparse: eq. (2). dense: minus the distance in [m], plus 1 where the sparse reward is 1."""
    motion: MotionName = "rest"
    """How the target moves: one of :data:`cdcsr.tasks.target_motion.MOTIONS`."""
    quiet: bool = False
    """The tip is on the target only while the base is within `BASE_SHIFT` and `BASE_TILT` of its start."""
    max_steps: int = 250
    """Simulation steps after which an episode is truncated."""
    period: float = 0.0025
    """Time from one action to the next, in [s]; an environment puts its own here."""

    kind: ClassVar[str]
    ends: ClassVar[bool] = True
    """Success ends the episode."""
    remembers: ClassVar[tuple[str, ...]] = ()
    """Names of the counts in its memory."""

    def __post_init__(self) -> None:
        if self.reward_kind not in get_args(Reward):
            raise CdcsrError(f"reward must be 'sparse' or 'dense', not {self.reward_kind!r}.")
        if not self.threshold > 0:
            raise CdcsrError(f"threshold must be positive, not {self.threshold:g}.")
        make_motion(self.motion)

    @property
    def name(self) -> str:
        """What tells its episodes from another task's: kind, motion, quietness and threshold."""
        parts = [
            self.kind,
            *([self.motion] if self.motion != "rest" else []),
            *(["quiet"] if self.quiet else []),
        ]
        if self.threshold != Task.threshold:
            parts.append(f"{1e3 * self.threshold:g}mm")
        name = "-".join(parts)
        return {"reach-quiet": "quiet", "reach-10mm": "precise"}.get(name, name)

    # -- how it is going ------------------------------------------------------------------------------------

    def memory(self, num: int) -> Memory:
        """Of `num` episodes that begin."""
        return {name: np.zeros(num, np.int64) for name in self.remembers}

    def judge(
        self,
        state: State,
        target_velocity: Array,
        distance: Array,
        memory: Memory,
        count: bool = True,
    ) -> Verdict:
        """How things stand; `memory` is brought up to date.

        Args:
            state: of all copies.
            target_velocity: shape (num, 3), in [m/s].
            distance: from tip to target, shape (num,), in [m].
            memory: of all copies.
            count: an action was taken; without one, `memory` stays as it is.
        """
        motion = state.tip_velocity - target_velocity
        on_target = self.on_target(distance, motion, state.base_position, state.base_quaternion)
        if count:
            self._count(on_target, memory)
        return self._verdict(on_target, memory)

    def on_target(
        self,
        distance: Array,
        motion: Array,
        base_position: Array,
        base_quaternion: Array,
    ) -> Mask:
        """Whether the tip is where it should be at one moment, shape (n,).

        Args:
            distance: from tip to target, shape (n,), in [m].
            motion: of the tip relative to the target, shape (n, 3), in [m/s].
            base_position: shape (n, 3), in [m].
            base_quaternion: w-x-y-z, shape (n, 4).
        """
        near = distance <= self.threshold
        if self.quiet:
            shift, tilt = base_errors(base_position, base_quaternion)
            near &= (shift <= BASE_SHIFT) & (tilt <= BASE_TILT)
        return near

    @abstractmethod
    def _count(self, on_target: Mask, memory: Memory) -> None:
        """Bring the memory up to date after an action."""

    @abstractmethod
    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict: ...

    def reward(self, distance: Array, rewarded: Mask) -> Array:
        """Shape (num,)."""
        if self.reward_kind == "sparse":
            return rewarded.astype(np.float64)
        return rewarded - distance

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:
        """What `info` holds besides distance, success and whether on target, by name; each of shape (num,)."""
        return {}

    def episode_rewards(self, observations: Array, success: bool) -> Array:
        """Of a recorded episode of T actions, shape (T,); of its observations, shape (T + 1, 23 + C), at that.

        Args:
            observations: the last is what the last action led to.
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
        """After how many actions a recorded episode would have succeeded with a target elsewhere, at rest.

        Args:
            tip_position: before each of T actions and after the last, shape (T + 1, 3), in [m].
            tip_velocity: shape (T + 1, 3), in [m/s].
            target: shape (3,), in [m].
            base_position: shape (T + 1, 3), in [m]; only for a quiet task.
            base_quaternion: w-x-y-z, shape (T + 1, 4); only for a quiet task.

        Returns:
            From 1 to T, or None if it would not have succeeded.
        """
        if base_position is None or base_quaternion is None:
            if self.quiet:
                raise ValueError(
                    "A quiet task is judged by the base, too: give its positions and quaternions."
                )
            base_position, base_quaternion = (
                np.zeros((len(tip_position), 3)),
                np.zeros((len(tip_position), 4)),
            )
        distance = np.linalg.norm(tip_position - target, axis=1)
        holds = self.on_target(distance, tip_velocity, base_position, base_quaternion)[1:]
        return self._first_success(holds)

    def _first_success(self, on_target: Mask) -> int | None:
        """:meth:`first_success` of one episode, from where it was on target after each action, shape (T,)."""
        memory = self.memory(1)
        for done, holds in enumerate(on_target, start=1):
            self._count(np.array([holds]), memory)
            if self._verdict(np.array([holds]), memory).success[0]:
                return done
        return None


def base_errors(position: Array, quaternion: Array) -> tuple[Array, Array]:
    """How far the base is from its start, where the world frame is: distance, in [m], and angle, in [rad].

    Args:
        position: shape (n, 3), in [m].
        quaternion: w-x-y-z, shape (n, 4), unit length.
    """
    vector, scalar = np.linalg.norm(quaternion[:, 1:], axis=1), np.abs(quaternion[:, 0])
    angle: Array = 2 * np.arctan2(vector, scalar)
    return np.linalg.norm(position, axis=1), angle
