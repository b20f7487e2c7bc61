"""The goal-conditioned environments: reach, with the goals apart from the rest of the observation.

`cdcsr/ReachGoal-v0` has the dictionary observations and the method `compute_reward` that hindsight
experience replay asks for. Its episodes are those of `cdcsr/Reach-v0`.
"""

from __future__ import annotations

from typing import Unpack

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cdcsr.envs.gym_env import Array, Info, Mask, TaskVectorEnv
from cdcsr.envs.options import EnvOptions
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.simulation.arguments import as_floats
from cdcsr.tasks.catalogue import Reach
from cdcsr.tasks.observation import as_goals
from cdcsr.tasks.task import Task

Goals = dict[str, Array]
"""An observation: `observation`, which holds no target; `achieved_goal`, where the tip is; and
`desired_goal`, where the target is. The goals have the shape (..., 3), in [m]."""


class GoalVectorEnv(VectorEnv[Goals, Array, NDArray[np.generic]]):
    """Many robots that reach, with goals: :class:`TaskVectorEnv` with dictionary observations.

    ``gymnasium.make_vec("cdcsr/ReachGoal-v0", num_envs=N, ...)`` makes one. Observations that
    arrive late, noisy or not at all do so for goals too; the reward is by where the tip really is.

    Args:
        num_envs: how many robots.
        autoreset_mode: see :class:`TaskVectorEnv`.
        options: see :class:`EnvOptions`.

    Attributes:
        batch: the environment without goals.

    Raises:
        CdcsrError: the task is not to reach, or asks for more than the tip's position.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **options: Unpack[EnvOptions],
    ) -> None:
        self.batch = TaskVectorEnv(num_envs, autoreset_mode=autoreset_mode, **options)
        _check_task(self.batch.task)
        self.num_envs, self.metadata = num_envs, self.batch.metadata
        self.single_action_space = self.batch.single_action_space
        self.action_space = self.batch.action_space
        self.single_observation_space = _goal_space(self.batch.single_observation_space.shape)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Goals, Info]:
        """Begin new episodes; see :meth:`TaskVectorEnv.reset`."""
        super().reset(seed=seed)
        observation, info = self.batch.reset(seed=seed, options=options)
        return as_goals(observation), info

    def step(self, actions: ArrayLike) -> tuple[Goals, Array, Mask, Mask, Info]:
        """Advance all robots by one action; see :meth:`TaskVectorEnv.step`. The entry `final_obs`
        of the info is a dictionary of arrays too."""
        observation, reward, terminated, truncated, info = self.batch.step(actions)
        if "final_obs" in info:
            info["final_obs"] = as_goals(info["final_obs"])
        return as_goals(observation), reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: object
    ) -> Array:
        """Return the rewards of having reached some places while others were asked for.

        Args:
            achieved_goal: where the tip is, shape (..., 3), in [m].
            desired_goal: where the target is, the same shape, in [m].
            info: it is not read.

        Returns:
            The task's rewards, shape (...).
        """
        return _compute_reward(self.batch.task, achieved_goal, desired_goal)

    def close_extras(self, **_: object) -> None:
        """Release what the engine holds; Gymnasium calls this from `close`."""
        self.batch.close()


class GoalEnv(gym.Env[Goals, Array]):
    """One robot that reaches, with goals: :class:`TaskEnv` with dictionary observations.

    ``gymnasium.make("cdcsr/ReachGoal-v0", ...)`` makes one.

    Args:
        render_mode, camera: see :class:`TaskEnv`.
        options: see :class:`EnvOptions`.

    Raises:
        CdcsrError: the task is not to reach, or asks for more than the tip's position.
    """

    metadata = TaskEnv.metadata

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "side",
        **options: Unpack[EnvOptions],
    ) -> None:
        self.render_mode = render_mode
        self._env = TaskEnv(render_mode, camera, **options)
        self.batch = self._env.batch
        _check_task(self.batch.task)
        self.action_space = self._env.action_space
        self.observation_space = _goal_space(self.batch.single_observation_space.shape)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Goals, Info]:
        """Begin a new episode; see :meth:`TaskEnv.reset`."""
        super().reset(seed=seed)
        observation, info = self._env.reset(seed=seed, options=options)
        return as_goals(observation), info

    def step(self, action: Array) -> tuple[Goals, float, bool, bool, Info]:
        """Advance the robot by one action; see :meth:`TaskEnv.step`."""
        observation, reward, terminated, truncated, info = self._env.step(action)
        return as_goals(observation), reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: object
    ) -> Array:
        """Return rewards, shape (...); see :meth:`GoalVectorEnv.compute_reward`."""
        return _compute_reward(self.batch.task, achieved_goal, desired_goal)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the robot and the target; see :meth:`TaskEnv.render`."""
        return self._env.render()

    def close(self) -> None:
        """Release what the engine holds."""
        self._env.close()


def _check_task(task: Task) -> None:
    """Check that the position of the tip alone decides the reward.

    Raises:
        CdcsrError: it does not.
    """
    if not isinstance(task, Reach) or task.quiet:
        raise CdcsrError(
            f"A goal is a position of the tip, which does not decide the task {task.name!r}; use "
            "the task 'reach' or 'precise', or cdcsr/Reach-v0 and cdcsr/Capture-v0 without goals."
        )


def _goal_space(shape: tuple[int, ...] | None) -> gym.Space:
    """Return the space of observations with goals, from the shape of those without."""
    example = as_goals(np.zeros(shape or ()))
    return gym.spaces.Dict(
        {
            name: gym.spaces.Box(-np.inf, np.inf, part.shape, np.float64)
            for name, part in example.items()
        }
    )


def _compute_reward(task: Task, achieved_goal: ArrayLike, desired_goal: ArrayLike) -> Array:
    """Return the rewards of a task that :func:`_check_task` lets through, shape (...)."""
    achieved = np.asarray(achieved_goal, dtype=np.float64)
    apart = as_floats("desired_goal", desired_goal, achieved.shape) - achieved
    distance = np.sqrt(np.einsum("...i,...i->...", apart, apart))
    unread = np.zeros((distance.size, 4))
    on_target = task.on_target(distance.ravel(), unread[:, :3], unread[:, :3], unread)
    return task.reward(distance, on_target.reshape(distance.shape))
