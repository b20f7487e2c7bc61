"""What the robot is asked to do: reach, capture, follow; by name, with all their numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import BASE_POSITION, BASE_QUATERNION, DISTANCE, TIP_VELOCITY
from cdcsr.tasks.target_motion import MotionName
from cdcsr.tasks.task import Array, Mask, Memory, Task, Verdict, base_errors


@dataclass(frozen=True)
class Reach(Task):
    """Bring the tip onto the target, fast or slow (BATD3 paper, section III-A)."""

    kind: ClassVar[str] = "reach"

    def _count(self, on_target: Mask, memory: Memory) -> None:
        """There is nothing to remember."""

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:
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

    def on_target(
        self, distance: Array, motion: Array, base_position: Array, base_quaternion: Array
    ) -> Mask:
        near = super().on_target(distance, motion, base_position, base_quaternion)
        return near & (np.linalg.norm(motion, axis=1) < self.speed)

    def _count(self, on_target: Mask, memory: Memory) -> None:
        memory["dwelt"] += 1
        memory["dwelt"] *= on_target

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:
        success = memory["dwelt"] >= actions_in(self.dwell, self.period)
        return Verdict(on_target, success, success, success)

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:
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
    ends: ClassVar[bool] = False
    remembers: ClassVar[tuple[str, ...]] = (
        "actions",
        "settled_on_target",
        "since_contact",
        "on_target",
    )

    def _count(self, on_target: Mask, memory: Memory) -> None:
        memory["actions"] += 1
        memory["settled_on_target"] += on_target & (self._counted(memory) > 0)
        memory["since_contact"] += on_target | (memory["since_contact"] > 0)
        memory["on_target"] += on_target

    def _verdict(self, on_target: Mask, memory: Memory) -> Verdict:
        counted = self._counted(memory)
        # In whole actions, so that 90 of 100 are 90 %.
        success = (counted > 0) & (
            memory["settled_on_target"] >= np.ceil(self.share * counted - 1e-9)
        )
        return Verdict(on_target, success, np.zeros_like(success), on_target)

    def _counted(self, memory: Memory) -> NDArray[np.int64]:
        """Actions after settling, shape (num,)."""
        return np.maximum(memory["actions"] - actions_in(self.settling, self.period), 0)

    def report(self, state: State, verdict: Verdict, memory: Memory) -> dict[str, Array]:
        """Share of actions since the first contact that left the tip on target (0 before it), and base errors."""
        shift, tilt = base_errors(state.base_position, state.base_quaternion)
        return {
            "share_on_target": memory["on_target"].astype(np.float64)
            / np.maximum(memory["since_contact"], 1),
            "base_position_error": shift,
            "base_attitude_error": tilt,
        }

    def episode_rewards(self, observations: Array, success: bool) -> Array:
        after = observations[1:]
        on_target = self.on_target(
            after[:, DISTANCE],
            after[:, TIP_VELOCITY],
            after[:, BASE_POSITION],
            after[:, BASE_QUATERNION],
        )
        return self.reward(after[:, DISTANCE], on_target)

    def _first_success(self, on_target: Mask) -> int | None:
        """It is decided at the end."""
        memory = self.memory(1)
        for holds in on_target:
            self._count(np.array([holds]), memory)
        return len(on_target) if self._verdict(on_target[-1:], memory).success[0] else None


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


def actions_in(time: float, period: float) -> int:
    """How many actions, one every `period`, it takes for `time` to pass; both in [s]."""
    return int(np.ceil(time / period - 1e-9))


def actions_per_episode(max_steps: int, frame_skip: int) -> int:
    """How many actions, each held for `frame_skip` simulation steps, fit into `max_steps`.

    Raises:
        CdcsrError: not even one fits, or it would not be held for a step.
    """
    if not 1 <= frame_skip <= max_steps:
        raise CdcsrError(
            f"frame_skip must be between 1 and max_steps ({max_steps}), not {frame_skip}."
        )
    return max_steps // frame_skip
