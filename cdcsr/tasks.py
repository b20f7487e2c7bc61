"""What the robot is asked to do, as functions of State: observation, reward, success."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.motions import MotionName, make_motion
from cdcsr.robot import Robot
from cdcsr.simulation import State

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Memory = dict[str, NDArray[np.int64]]
"""What a task remembers of the episode of each copy: counts of shape (num,), all zero when it begins."""
Reward = Literal["sparse", "dense"]


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

    The observation is eq. (1) of the BATD3 paper: tip position and velocity, target, distance, base position,
    quaternion (w-x-y-z), velocity and angular velocity, and cable travel; world frame, SI units. Of a target that
    moves it shows where it is, and not how it moves.
    """

    threshold: float = 0.03
    """The tip is on the target within this distance, in [m]."""
    reward_kind: Reward = "sparse"
    """sparse: eq. (2). dense: minus the distance in [m], plus 1 where the sparse reward is 1."""
    motion: MotionName = "rest"
    """How the target moves: one of :data:`cdcsr.motions.MOTIONS`."""
    quiet: bool = False
    """The tip is on the target only while the base is within `BASE_SHIFT` and `BASE_TILT` of its start."""
    max_steps: int = 250
    """Simulation steps after which an episode is truncated."""
    period: float = 0.0025
    """Time from one action to the next, in [s]; an environment puts its own here."""

    kind: ClassVar[str]
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
        parts = [self.kind, *([self.motion] if self.motion != "rest" else []), *(["quiet"] if self.quiet else [])]
        if self.threshold != Task.threshold:
            parts.append(f"{1e3 * self.threshold:g}mm")
        name = "-".join(parts)
        return {"reach-quiet": "quiet", "reach-10mm": "precise"}.get(name, name)

    # -- what is seen ---------------------------------------------------------------------------------------

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

    # -- how it is going ------------------------------------------------------------------------------------

    def memory(self, num: int) -> Memory:
        """Of `num` episodes that begin."""
        return {name: np.zeros(num, np.int64) for name in self.remembers}

    def judge(
        self, state: State, target_velocity: Array, distance: Array, memory: Memory, count: bool = True
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
        motion: Array,  # noqa: ARG002 (some tasks look at it)
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

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:  # noqa: ARG002
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
                raise ValueError("A quiet task is judged by the base, too: give its positions and quaternions.")
            base_position, base_quaternion = np.zeros((len(tip_position), 3)), np.zeros((len(tip_position), 4))
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


@dataclass(frozen=True)
class Reach(Task):
    """Bring the tip onto the target, fast or slow (BATD3 paper, section III-A)."""

    kind: ClassVar[str] = "reach"

    def _count(self, on_target: Mask, memory: Memory) -> None:
        """There is nothing to remember."""

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:  # noqa: ARG002
        return Verdict(on_target, on_target, on_target, on_target)

    def _first_success(self, on_target: Mask) -> int | None:
        return int(on_target.argmax()) + 1 if on_target.any() else None


@dataclass(frozen=True)
class Capture(Task):
    """Bring the tip onto the target and keep it there, slow relative to it, long enough to grasp."""

    max_steps: int = 500
    speed: float = 0.1
    """On target is only a tip slower than this relative to the target, in [m/s]."""
    dwell: float = 0.1
    """Success is having been on target after every action for this long, in [s]."""

    kind: ClassVar[str] = "capture"
    remembers: ClassVar[tuple[str, ...]] = ("dwelt",)

    def on_target(self, distance: Array, motion: Array, base_position: Array, base_quaternion: Array) -> Mask:
        near = super().on_target(distance, motion, base_position, base_quaternion)
        return near & (np.linalg.norm(motion, axis=1) < self.speed)

    def _count(self, on_target: Mask, memory: Memory) -> None:
        memory["dwelt"] += 1
        memory["dwelt"] *= on_target

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:
        success = memory["dwelt"] >= actions_in(self.dwell, self.period)
        return Verdict(on_target, success, success, success)

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:  # noqa: ARG002
        """How long the tip has been on target, in [s]."""
        return {"dwelt": memory["dwelt"].astype(np.float64) * self.period}


@dataclass(frozen=True)
class Follow(Task):
    """Keep the tip on a target that moves, until time is up (BATD3 paper, section V-F).

    The reward is 1 after every action that leaves the tip on the target. An episode is a success if that was so
    after at least 90 % of the actions that came once the arm had had the time of a reach, 0.625 s; before its end,
    `is_success` says how it stands so far.
    """

    motion: MotionName = "line"
    max_steps: int = 1000
    settling: float = 0.625
    """[s]."""
    share: float = 0.9

    kind: ClassVar[str] = "follow"
    remembers: ClassVar[tuple[str, ...]] = ("actions", "settled_on_target", "since_contact", "on_target")

    def _count(self, on_target: Mask, memory: Memory) -> None:
        memory["actions"] += 1
        memory["settled_on_target"] += on_target & (self._counted(memory) > 0)
        memory["since_contact"] += on_target | (memory["since_contact"] > 0)
        memory["on_target"] += on_target

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:
        counted = self._counted(memory)
        # In whole actions, so that 90 of 100 are 90 %.
        success = (counted > 0) & (memory["settled_on_target"] >= np.ceil(self.share * counted - 1e-9))
        return Verdict(on_target, success, np.zeros_like(success), on_target)

    def _counted(self, memory: Memory) -> NDArray[np.int64]:
        """Actions after settling, shape (num,)."""
        return np.maximum(memory["actions"] - actions_in(self.settling, self.period), 0)

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:  # noqa: ARG002
        """Share of actions since the first contact that left the tip on target (0 before it), and base errors."""
        shift, tilt = base_errors(state.base_position, state.base_quaternion)
        return {
            "share_on_target": memory["on_target"].astype(np.float64) / np.maximum(memory["since_contact"], 1),
            "base_position_error": shift,
            "base_attitude_error": tilt,
        }

    def episode_rewards(self, observations: Array, success: bool) -> Array:  # noqa: ARG002
        after = observations[1:]
        on_target = self.on_target(
            after[:, DISTANCE], after[:, TIP_VELOCITY], after[:, BASE_POSITION], after[:, BASE_QUATERNION]
        )
        return self.reward(after[:, DISTANCE], on_target)

    def _first_success(self, on_target: Mask) -> int | None:
        """It is decided at the end."""
        memory = self.memory(1)
        for holds in on_target:
            self._count(np.array([holds]), memory)
        return len(on_target) if self._verdict(on_target[-1:], memory).success[0] else None


BASE_SHIFT, BASE_TILT = 0.003, 0.05
"""How far a quiet base may be from its start, in [m] and [rad]: what the paper reports for Fig. 6."""

TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Reach(),
        Reach(threshold=0.01),
        Reach(quiet=True),
        Capture(),
        Capture(motion="drift"),
        Capture(motion="tumble"),
        Follow(),
        Follow(motion="circle"),
        Follow(motion="random"),
    )
}
"""The named tasks: reach, precise, quiet, capture, capture-drift, ..., follow-line, ..."""


def make_task(name: str | Task, **changes: Any) -> Task:
    """A task by its name in :data:`TASKS`, with other numbers where `changes` give them.

    Args:
        name: its name, or a task.
        changes: fields of the task; None keeps what it has.

    Raises:
        CdcsrError: there is no such task, or a number does not fit.
    """
    if isinstance(name, str):
        if name not in TASKS:
            raise CdcsrError(unknown_choice("task", name, TASKS))
        name = TASKS[name]
    return replace(name, **{field: value for field, value in changes.items() if value is not None})


def base_errors(position: Array, quaternion: Array) -> tuple[Array, Array]:
    """How far the base is from its start, where the world frame is: distance, in [m], and angle, in [rad].

    Args:
        position: shape (n, 3), in [m].
        quaternion: w-x-y-z, shape (n, 4), unit length.
    """
    vector, scalar = np.linalg.norm(quaternion[:, 1:], axis=1), np.abs(quaternion[:, 0])
    angle: Array = 2 * np.arctan2(vector, scalar)
    return np.linalg.norm(position, axis=1), angle


TIP_POSITION, TIP_VELOCITY, TARGET, DISTANCE = slice(0, 3), slice(3, 6), slice(6, 9), 9
BASE_POSITION, BASE_QUATERNION = slice(10, 13), slice(13, 17)
"""Where parts of eq. (1) are in the observation."""


def with_target(observations: Array, target: Array) -> Array:
    """The same observations, shape (..., 23 + C), with a target elsewhere, shape (3,), and the distance to it."""
    moved = np.array(observations)
    moved[..., TARGET] = target
    moved[..., DISTANCE] = np.linalg.norm(target - moved[..., TIP_POSITION], axis=-1)
    return moved


def observation_size(robot: Robot) -> int:
    """Length of eq. (1)."""
    return 23 + robot.num_cables


def actions_in(time: float, period: float) -> int:
    """How many actions, one every `period`, it takes for `time` to pass; both in [s]."""
    return int(np.ceil(time / period - 1e-9))


def actions_per_episode(max_steps: int, frame_skip: int) -> int:
    """How many actions, each held for `frame_skip` simulation steps, fit into `max_steps`.

    Raises:
        CdcsrError: not even one fits, or it would not be held for a step.
    """
    if not 1 <= frame_skip <= max_steps:
        raise CdcsrError(f"frame_skip must be between 1 and max_steps ({max_steps}), not {frame_skip}.")
    return max_steps // frame_skip
