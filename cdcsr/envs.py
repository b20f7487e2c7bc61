"""Gymnasium environments over any engine: `cdcsr/Reach-v0`, one robot or many."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cdcsr.disturbances import Channel, Disturbances
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot import Robot, load_robot
from cdcsr.simulation import make_simulation
from cdcsr.spaces import make_space
from cdcsr.tasks import Reach, Reward, actions_per_episode, observation_size

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EPISODE_STEPS = 250
"""Simulation steps an episode may take (BATD3 paper, section V-A)."""


class ReachVectorEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """Many robots reaching for targets, stepped as one batch by the engine.

    Made by ``gymnasium.make_vec("cdcsr/Reach-v0", num_envs=N, ...)``. The autoreset mode is SAME_STEP: when an
    episode ends, the observation returned is the first of the next one, and the last of the old one is in
    ``info["final_obs"]``. ``info["is_success"]`` and ``info["distance"]`` are always of the step just made.
    With ``autoreset_mode=AutoresetMode.DISABLED`` finished episodes simply go on until reset.

    Args:
        num_envs: how many robots.
        robot: a Robot, a path, or the name of a shipped one.
        backend: the engine.
        space: the operation space targets are drawn from.
        reward: "sparse" (eq. 2) or "dense".
        frame_skip: simulation steps each action is held for.
        max_steps: simulation steps after which an episode is truncated.
        threshold: success within this distance, in [m].
        centers: the demonstrations' targets that Floating and Spatter surround, shape (n, 3), in [m].
        disturbances: what goes wrong between policy and robot.
        autoreset_mode: SAME_STEP or DISABLED.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: Robot | str = "paper",
        backend: str = "mujoco",
        space: str = "anchor",
        reward: Reward = "sparse",
        frame_skip: int = 1,
        max_steps: int = EPISODE_STEPS,
        threshold: float = 0.03,
        centers: Array | None = None,
        disturbances: Disturbances | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        mode = AutoresetMode(autoreset_mode)
        if mode is AutoresetMode.NEXT_STEP:
            raise CdcsrError("autoreset_mode must be SAME_STEP or DISABLED; NEXT_STEP would waste a step.")
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.backend, self.frame_skip = backend, frame_skip
        self.task = Reach(threshold, reward)
        self.space = make_space(space, self.robot, centers)
        self.max_actions = actions_per_episode(max_steps, frame_skip)
        self.simulation = make_simulation(self.robot, backend, num_envs)
        self.num_envs = num_envs
        self.single_observation_space = gym.spaces.Box(-np.inf, np.inf, (observation_size(self.robot),), np.float64)
        self._eta = np.array([servo.eta for servo in self.robot.servos])
        self.single_action_space = gym.spaces.Box(-self._eta, np.zeros_like(self._eta), dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"autoreset_mode": mode, "render_modes": []}
        self._autoreset = mode is AutoresetMode.SAME_STEP
        self._disturbances = disturbances or Disturbances()
        self._channel = Channel(self._disturbances, self.np_random)
        self.targets = np.zeros((num_envs, 3))
        self.actions_taken = np.zeros(num_envs, dtype=np.int64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: seeds the one generator that draws all targets and disturbances.
            options: ``targets``, shape (num_envs, 3), to set instead of drawing; ``reset_mask``, shape
                (num_envs,), to begin only some episodes.

        Raises:
            CdcsrError: an unknown option, or one of the wrong shape.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._channel = Channel(self._disturbances, self.np_random)
        given = _read_options(options, targets=(self.num_envs, 3), reset_mask=(self.num_envs,))
        fresh = given.get("reset_mask", np.ones(self.num_envs)).astype(np.bool_)
        observation = self._begin(fresh, given.get("targets"))
        state = self.simulation.state()
        distance = self.task.distance(state, self.targets)
        return observation, {"is_success": distance <= self.task.threshold, "distance": distance}

    def step(self, actions: Array) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        command = self._channel.command(np.asarray(actions, dtype=np.float64))
        command = np.minimum(np.maximum(command, -self._eta), 0)  # what np.clip does, in a third of its time
        self.simulation.step(command, self.frame_skip)
        self.actions_taken += 1
        state = self.simulation.state()
        distance = self.task.distance(state, self.targets)
        success = distance <= self.task.threshold
        observation = self._channel.observe(self.task.observe(state, self.targets, distance))
        reward = self.task.reward(distance, success)
        truncated = ~success & (self.actions_taken >= self.max_actions)
        info: dict[str, Any] = {"is_success": success, "distance": distance}
        done = success | truncated
        if self._autoreset and done.any():
            info |= {"final_obs": observation, "_final_obs": done, "_final_info": done}
            info["final_info"] = {"is_success": success, "distance": distance}
            observation = self._begin(done, None)
        return observation, reward, success.copy(), truncated, info

    def _begin(self, fresh: Mask, targets: Array | None) -> Array:
        """Start episodes where `fresh`; returns the observations of all copies."""
        ids = np.flatnonzero(fresh)
        if targets is None:
            self.targets[ids] = self.space.sample(self.np_random, len(ids))
        else:
            self.targets[ids] = targets[ids]
        self.simulation.reset(None if fresh.all() else ids)
        self.actions_taken[ids] = 0
        state = self.simulation.state()
        observation = self.task.observe(state, self.targets, self.task.distance(state, self.targets))
        return self._channel.start(observation, fresh)

    def close_extras(self, **_: Any) -> None:
        self.simulation.close()


class ReachEnv(gym.Env[Array, Array]):
    """One robot reaching for targets: :class:`ReachVectorEnv` with one copy and no autoreset.

    Made by ``gymnasium.make("cdcsr/Reach-v0", ...)``, which takes the same arguments.
    ``reset(options={"target": (x, y, z)})`` sets the target instead of drawing it.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, render_mode: str | None = None, **arguments: Any) -> None:
        self.render_mode = render_mode
        self.batch = ReachVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **arguments)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        given = _read_options(options, target=(3,))
        targets = {"targets": given["target"][None]} if given else None
        observation, info = self.batch.reset(seed=seed, options=targets)
        return observation[0], _first(info)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.batch.step(np.asarray(action)[None])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def render(self) -> NDArray[np.uint8] | None:
        return self.batch.simulation.render(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self.batch.close()


def _read_options(options: dict[str, Any] | None, **shapes: tuple[int, ...]) -> dict[str, Array]:
    """The options of a reset as arrays; a name that is not in `shapes` and another shape are errors."""
    arrays: dict[str, Array] = {}
    for name, value in (options or {}).items():
        if name not in shapes:
            raise CdcsrError(unknown_choice("reset option", name, shapes))
        arrays[name] = np.asarray(value, dtype=np.float64)
        if arrays[name].shape != shapes[name]:
            raise CdcsrError(f"The reset option {name!r} has the shape {shapes[name]}, not {arrays[name].shape}.")
    return arrays


def _first(info: dict[str, Any]) -> dict[str, Any]:
    return {"is_success": bool(info["is_success"][0]), "distance": float(info["distance"][0])}
