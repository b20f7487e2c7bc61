"""The episodes of many copies: their targets, and what the task has counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import tip_distance
from cdcsr.tasks.spaces import Space
from cdcsr.tasks.target_motion import make_motion
from cdcsr.tasks.task import Mask, Task, Verdict

Array = NDArray[np.float64]


class Episodes:
    """The episode of each copy: where its target is, how it moves, and how far the task has come.

    Args:
        num: how many copies.
        task: what is judged, and how targets move.
        space: where targets are drawn.
        drifts: whether targets may drift with the robot, in addition to their own motion.

    Attributes:
        space: where targets are drawn.
        targets: shape (num, 3), in [m].
        target_velocity: shape (num, 3), in [m/s].
        drift: the part of it that the robot shares from the start, shape (num, 3), in [m/s].
        actions_taken: shape (num,).
        counts: what the task counts.
    """

    def __init__(self, num: int, task: Task, space: Space, drifts: bool = False) -> None:
        self.space, self._task = space, task
        self._motion, self._moving = (
            make_motion(task.motion, task.size, task.pace),
            task.motion != "rest",
        )
        self._motion_memory = np.zeros((num, self._motion.size))
        self.targets, self.target_velocity, self.drift = np.zeros((3, num, 3))
        # Targets move in a frame that drifts; without drift it is the world.
        self._drifts = drifts
        self._place, self._velocity = self.targets, self.target_velocity
        if drifts:
            self._place, self._velocity = np.zeros((2, num, 3))
        self.actions_taken = np.zeros(num, dtype=np.int64)
        self.counts = task.new_counts(num)

    def begin(
        self,
        ids: NDArray[np.int64],
        rng: np.random.Generator,
        targets: Array | None = None,
        drift: Array | None = None,
    ) -> None:
        """Begin new episodes of the copies `ids`.

        Args:
            ids: which copies.
            rng: draws the targets, then how they move.
            targets: shape (num, 3), in [m]; where the targets begin, instead of drawing that.
            drift: of the episodes that begin, shape (len(ids), 3), in [m/s].
        """
        self._place[ids] = self.space.sample(rng, len(ids)) if targets is None else targets[ids]
        if self._moving:
            begun = self._motion.begin(rng, self._place[ids])
            self._velocity[ids], self._motion_memory[ids] = begun
        self.actions_taken[ids] = 0
        for count in self.counts.values():
            count[ids] = 0
        if drift is not None:
            self.drift[ids], self.targets[ids] = drift, self._place[ids]
            self.target_velocity[ids] = self._velocity[ids] + drift

    def restart(
        self,
        fresh: Mask,
        place: Array,
        velocity: Array,
        memory: Array,
        drift: Array | None = None,
    ) -> None:
        """Begin new episodes of some copies with motions that were drawn before.

        This is :meth:`begin` for arrays of any library, and for a mask that only a device knows.

        Args:
            fresh: which copies, shape (num,).
            place: where their targets begin, shape (num, 3), in [m]; other rows are ignored.
            velocity: of the targets, shape (num, 3), in [m/s].
            memory: of their motion, shape (num, its size).
            drift: of the episodes that begin, shape (num, 3), in [m/s]; given if targets drift.
        """
        where = array_namespace(place).where
        begun = [(self._place, place), (self._velocity, velocity), (self._motion_memory, memory)]
        if drift is not None:
            begun += [(self.drift, drift), (self.targets, place)]
            begun += [(self.target_velocity, velocity + drift)]
        for rows, new in begun:
            rows[:] = where(fresh[:, None], new, rows)
        for count in (self.actions_taken, *self.counts.values()):
            count *= ~fresh

    def convert(self, convert: Callable[[NDArray[np.generic]], Any]) -> None:
        """Keep arrays of another library from here on."""
        names = "targets", "target_velocity", "drift", "_motion_memory", "actions_taken"
        for name in names:
            setattr(self, name, convert(getattr(self, name)))
        if self._drifts:
            self._place, self._velocity = convert(self._place), convert(self._velocity)
        else:
            self._place, self._velocity = self.targets, self.target_velocity
        self.counts = {name: convert(count) for name, count in self.counts.items()}

    def advance(self, steps: int, time_step: float) -> None:
        """Count an action, and move the targets on by `steps` steps of `time_step` seconds."""
        if self._moving:
            for _ in range(steps):
                self._motion.advance(self._place, self._velocity, self._motion_memory, time_step)
        self.actions_taken += 1
        if self._drifts:
            time = self.actions_taken * (steps * time_step)
            self.targets[:] = self._place + self.drift * time[:, None]
            self.target_velocity[:] = self._velocity + self.drift

    def judge(self, state: State, count: bool = True) -> tuple[Array, Verdict]:
        """Return the distances from tip to target, shape (num,), in [m], and the task's verdict.

        Args:
            state: the measured state of all copies.
            count: whether an action was taken.
        """
        distance = tip_distance(state, self.targets)
        verdict = self._task.judge(state, self.target_velocity, distance, self.counts, count)
        return distance, verdict

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return all that determines how the episodes go on, by name; these are the arrays
        themselves, whose first axis is the copy."""
        return {
            "targets": self.targets,
            "target_velocity": self.target_velocity,
            "motion": self._motion_memory,
            "actions_taken": self.actions_taken,
            **(
                {"drift": self.drift, "place": self._place, "velocity": self._velocity}
                if self._drifts
                else {}
            ),
            **{f"task.{name}": count for name, count in self.counts.items()},
        }
