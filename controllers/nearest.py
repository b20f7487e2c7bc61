"""Replay the demonstration whose target is nearest: the baseline that learning has to beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import State
from controllers.controller import Conditions, Controller, Target
from controllers.demonstrations import record
from controllers.jacobian import JacobianController
from controllers.rollout import Episode

Array = NDArray[np.float64]

NUM_DEMONSTRATIONS, SEED = 10, 0
"""The paper's demonstrations: how many, and the seed of their targets."""


class Nearest(Controller):
    """Replays open loop, for each target, the demonstration whose target is nearest.

    It looks at the target once, when an episode begins, and never at the robot. After the last
    command of a demonstration it holds that command.

    Args:
        robot: the description.
        demonstrations: the episodes to choose from. By default ten of the scripted demonstrator in
            the Anchor Space (seed 0), recorded in the engine that simulates the robot: of reaching,
            or of capturing where the tip has to stay at the target.
    """

    name = "nearest"

    def __init__(self, robot: Robot, demonstrations: Sequence[Episode] = ()) -> None:
        self._robot, self._given = robot, list(demonstrations)
        self.frame_skip = ruler(robot).frame_skip
        self._recorded: dict[tuple[str, int, bool], list[Episode]] = {}

    def begin(self, conditions: Conditions) -> None:
        """Find the demonstrations, and record them if there are none.

        Raises:
            CdcsrError: there are none, and no engine to record them in.
        """
        self._period = conditions.period
        self._episodes = self._given or self._record(conditions)
        self._chosen = np.zeros(0, dtype=np.int64)

    def act(self, state: State, target: Target, time: Array) -> Array:
        actions = np.rint(np.nan_to_num(time) / self._period).astype(np.int64)
        if len(self._chosen) != len(time):
            targets = np.array([episode.target for episode in self._episodes])
            apart = np.linalg.norm(target.position[:, None] - targets, axis=2)
            self._chosen = apart.argmin(axis=1)
        episodes = [self._episodes[i] for i in self._chosen]
        return np.array(
            [e.actions[min(k, e.length - 1)] for e, k in zip(episodes, actions, strict=True)]
        )

    def _record(self, conditions: Conditions) -> list[Episode]:
        if conditions.engine is None:
            raise CdcsrError(
                "The controller 'nearest' has no demonstrations, and no engine to record some in; "
                "give it the folder of a dataset: nearest:FOLDER."
            )
        frame_skip = round(conditions.period / self._robot.time_step)
        key = (conditions.engine, frame_skip, conditions.stays)
        if key not in self._recorded:
            env = TaskVectorEnv(
                NUM_DEMONSTRATIONS,
                self._robot,
                conditions.engine,
                frame_skip=frame_skip,
                task="capture" if conditions.stays else "reach",
                autoreset_mode="Disabled",
            )
            try:
                demonstrator = JacobianController(self._robot)
                self._recorded[key], *_ = record(demonstrator, env, NUM_DEMONSTRATIONS, SEED)
            finally:
                env.close()
        return self._recorded[key]
