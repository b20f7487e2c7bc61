"""The batched environments as a `VecEnv`, for users of stable-baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from cdcsr.envs.goal_env import GoalVectorEnv
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError


class BatchedVecEnv(VecEnv):
    """Many robots, stepped as one batch, as stable-baselines3 expects its environments.

    When an episode ends, the observation returned is the first one of the next episode; the info of
    that robot holds the last one as `terminal_observation`, and as `TimeLimit.truncated` whether
    time was up.

    Args:
        env: the environment, from ``gymnasium.make_vec("cdcsr/Reach-v0", num_envs=N, ...)``, or
            with the id of another task. Its autoreset mode is SAME_STEP, the default.
        render_mode: "rgb_array" if pictures will be asked for, or None.

    Raises:
        CdcsrError: the environment is another one, or has another autoreset mode.
    """

    def __init__(self, env: gym.vector.VectorEnv, render_mode: str | None = None) -> None:
        if not isinstance(env, TaskVectorEnv | GoalVectorEnv):
            raise CdcsrError(
                f"BatchedVecEnv takes a batched environment of cdcsr, not {type(env).__name__}; "
                "make one with gymnasium.make_vec."
            )
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise CdcsrError("BatchedVecEnv needs autoreset_mode SAME_STEP, which is the default.")
        env.render_mode = render_mode
        self.env = env
        self._batch = env.batch if isinstance(env, GoalVectorEnv) else env
        self._actions: NDArray[np.float64] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Begin new episodes, with the seed and the options that were set before.

        Options are `{"target": (x, y, z)}`, in [m], for all robots or for none.
        """
        targets = [options["target"] for options in self._options if "target" in options]
        chosen = {"targets": np.array(targets)} if targets else None
        observation, info = self.env.reset(seed=self._seeds[0], options=chosen)
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [_row(info, i) for i in range(self.num_envs)]
        return observation

    def step_async(self, actions: NDArray[np.generic]) -> None:
        """Take note of the actions, shape (num_envs, C), in [m]."""
        self._actions = np.asarray(actions, dtype=np.float64)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all robots by the actions of :meth:`step_async`."""
        assert self._actions is not None
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done, last = terminated | truncated, info.pop("final_obs", None)
        for name in ("_final_obs", "final_info", "_final_info"):
            info.pop(name, None)
        infos = [_row(info, i) for i in range(self.num_envs)]
        for i, found in enumerate(infos):
            found["TimeLimit.truncated"] = bool(truncated[i])
            if done[i]:
                found["terminal_observation"] = _row(last, i) if isinstance(last, dict) else last[i]
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Release what the engine holds."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of every robot and its target."""
        batch = self._batch
        return [batch.simulation.render(i, target=batch.targets[i]) for i in range(self.num_envs)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the batched environment, once for each robot asked for."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the batched environment, which all robots share."""
        setattr(self.env, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: object,
        indices: VecEnvIndices = None,
        **method_kwargs: object,
    ) -> list[Any]:
        """Call a method of the batched environment, once for each robot asked for."""
        method = getattr(self.env, method_name)
        return [method(*method_args, **method_kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return that no robot has a wrapper of its own."""
        return [False for _ in self._get_indices(indices)]


def _row(rows: dict[str, NDArray[np.generic]], i: int) -> dict[str, Any]:
    """Return one robot's part of a dictionary of arrays; single numbers become Python's."""
    return {name: part[i] if part.ndim > 1 else part[i].item() for name, part in rows.items()}
