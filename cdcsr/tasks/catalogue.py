"""The tasks: reach, capture and follow, and the list of all named tasks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import rounded, ruler
from cdcsr.simulation.arguments import check_count
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import BASE_POSITION, BASE_QUATERNION, DISTANCE, TIP_VELOCITY
from cdcsr.tasks.target_motion import MotionName
from cdcsr.tasks.task import Array, Counts, Mask, Task, Verdict, base_errors


@dataclass(frozen=True)
class Reach(Task):
    """Bring the tip onto the target, at any speed (BATD3 paper, section III-A)."""

    kind: ClassVar[str] = "reach"

    def _count(self, on_target: Mask, counts: Counts) -> None:
        """Count nothing."""

    def _verdict(self, on_target: Mask, counts: Counts) -> Verdict:
        return Verdict(on_target, on_target, on_target, on_target)

    def first_successes(self, on_target: Mask) -> NDArray[np.int64]:
        xp = array_namespace(on_target)
        ever = xp.astype(on_target, xp.int8)
        return (xp.argmax(ever, axis=1) + 1) * xp.any(on_target, axis=1)


@dataclass(frozen=True)
class Capture(Task):
    """Bring the tip onto the target and keep it there, slow enough and long enough to grasp it."""

    max_steps: int = 500
    speed: float = 0.1
    """The tip is on the target only if it is slower than this, relative to it, in [m/s]."""
    dwell: float = 0.1
    """The episode succeeds once the tip was on target after every action for this long, in [s]."""

    kind: ClassVar[str] = "capture"
    count_names: ClassVar[tuple[str, ...]] = ("dwelt",)

    def of(self, robot: Robot) -> Self:
        own = ruler(robot)
        dwell = rounded(self.dwell * own.pace)
        return replace(super().of(robot), speed=own.capture_speed, dwell=dwell)

    def _is_slow(self, relative_velocity: Array) -> Mask:
        xp = array_namespace(relative_velocity)
        return xp.linalg.vector_norm(relative_velocity, axis=1) < self.speed

    def _count(self, on_target: Mask, counts: Counts) -> None:
        counts["dwelt"] += 1
        counts["dwelt"] *= on_target

    def _verdict(self, on_target: Mask, counts: Counts) -> Verdict:
        success = counts["dwelt"] >= actions_in(self.dwell, self.period)
        return Verdict(on_target, success, success, success)

    def extra_info(self, state: State, counts: Counts) -> dict[str, Array]:
        """Return `dwelt`: how long the tip has been on target without a break, in [s]."""
        return {"dwelt": counts["dwelt"].astype(np.float64) * self.period}


@dataclass(frozen=True)
class Follow(Task):
    """Keep the tip on a moving target until time is up (BATD3 paper, section V-F).

    The reward is 1 after every action that leaves the tip on the target. The actions of the first
    0.625 s, the time of a reach, do not count for success; the episode succeeds if the tip was on
    target after at least 90 % of the others. Before its end, `is_success` says how it stands.
    """

    motion: MotionName = "line"
    max_steps: int = 1000
    settling: float = 0.625
    """The time at the start that does not count for success, in [s]."""
    share: float = 0.9
    """The share of the other actions that must leave the tip on target."""

    kind: ClassVar[str] = "follow"
    ends: ClassVar[bool] = False
    count_names: ClassVar[tuple[str, ...]] = (
        "actions",
        "settled_on_target",
        "since_contact",
        "on_target",
    )

    def of(self, robot: Robot) -> Self:
        return replace(super().of(robot), settling=rounded(self.settling * ruler(robot).pace))

    def _count(self, on_target: Mask, counts: Counts) -> None:
        counts["actions"] += 1
        counts["settled_on_target"] += on_target & (self._settled_actions(counts) > 0)
        counts["since_contact"] += on_target | (counts["since_contact"] > 0)
        counts["on_target"] += on_target

    def _verdict(self, on_target: Mask, counts: Counts) -> Verdict:
        settled = self._settled_actions(counts)
        # In whole actions, so that 90 of 100 are 90 %.
        xp = array_namespace(settled)
        least = xp.ceil(self.share * settled - 1e-9)
        success = (settled > 0) & (counts["settled_on_target"] >= least)
        return Verdict(on_target, success, xp.zeros_like(success), on_target)

    def _settled_actions(self, counts: Counts) -> NDArray[np.int64]:
        """Return how many actions came after settling, shape (num,)."""
        settled = counts["actions"] - actions_in(self.settling, self.period)
        return settled * (settled > 0)

    def extra_info(self, state: State, counts: Counts) -> dict[str, Array]:
        """Return the share of actions since the first contact that left the tip on target (zero
        before it), and the distance and angle of the base from its start, in [m] and [rad]."""
        shift, tilt = base_errors(state.base_position, state.base_quaternion)
        since_contact = np.maximum(counts["since_contact"], 1)
        return {
            "share_on_target": counts["on_target"].astype(np.float64) / since_contact,
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

    def first_successes(self, on_target: Mask) -> NDArray[np.int64]:
        """Return T where the episode succeeds, else 0; only its end decides that."""
        num, actions = on_target.shape
        counts = self.new_counts(num)
        for action in range(actions):
            self._count(on_target[:, action], counts)
        return actions * self._verdict(on_target[:, -1], counts).success.astype(np.int64)


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
"""All named tasks, with the numbers of the paper's robot: reach, precise, quiet, capture, ..."""


def make_task(name: str | Task, robot: Robot | None = None, **changes: object) -> Task:
    """Return a task with some of its numbers changed.

    Args:
        name: a name in :data:`TASKS`, or a task.
        robot: a task given by its name has this robot's own numbers; by default those of the
            paper's.
        changes: fields of the task; a value of None changes nothing.

    Raises:
        CdcsrError: there is no such task, or a number is out of range.
    """
    if isinstance(name, str):
        if name not in TASKS:
            raise CdcsrError(unknown_choice("task", name, TASKS))
        name = TASKS[name] if robot is None else TASKS[name].of(robot)
    return replace(name, **{field: value for field, value in changes.items() if value is not None})


def actions_in(time: float, period: float) -> int:
    """Return how many actions, one every `period`, it takes for `time` to pass; both in [s]."""
    return int(np.ceil(time / period - 1e-9))


def actions_per_episode(max_steps: int, frame_skip: int) -> int:
    """Return how many actions, each held for `frame_skip` simulation steps, fit into `max_steps`.

    Raises:
        CdcsrError: frame_skip is below 1 or above max_steps.
    """
    check_count("frame_skip", frame_skip, max_steps)
    return max_steps // frame_skip
