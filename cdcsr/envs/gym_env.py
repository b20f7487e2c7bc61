"""Gymnasium environments over any engine: `cdcsr/Reach-v0`, `Capture-v0` and `Follow-v0`, one robot or many."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.envs.rng_state import pack_generator, unpack_generator
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Snapshot, State
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.observation import observation_size, observe, tip_distance
from cdcsr.tasks.spaces import make_space
from cdcsr.tasks.target_motion import MotionName, make_motion
from cdcsr.tasks.task import Reward, Task, Verdict

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EPISODE_STEPS = Task.max_steps
"""Simulation steps a Reach episode may take (BATD3 paper, section V-A)."""
_SNAPSHOT = ("time", "position", "velocity", "private")
"""The arrays of a snapshot that are always there."""


class TaskVectorEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """Many robots at a task, stepped as one batch by the engine.

    Made by ``gymnasium.make_vec("cdcsr/Reach-v0", num_envs=N, ...)``, or Capture or Follow. The autoreset mode is
    SAME_STEP: when an episode ends, the observation returned is the first of the next one, and the last of the old
    one is in ``info["final_obs"]``. ``info["is_success"]`` and ``info["distance"]`` are always of the step just
    made; what else a task reports is described there. With ``autoreset_mode=AutoresetMode.DISABLED`` finished
    episodes simply go on until reset.

    Args:
        num_envs: how many robots.
        robot: a Robot, a path, or the name of a shipped one.
        backend: the engine.
        space: the operation space targets are drawn from.
        reward: "sparse" (eq. 2) or "dense".
        frame_skip: simulation steps each action is held for.
        max_steps: simulation steps after which an episode is truncated; by default the task's.
        threshold: the tip is on the target within this distance, in [m]; by default the task's.
        centers: the demonstrations' targets that Floating and Spatter surround, shape (n, 3), in [m].
        disturbances: what goes wrong between policy and robot.
        autoreset_mode: SAME_STEP or DISABLED.
        randomization: draws a new plant for every episode; by default all are the description's.
        task: a name in :data:`cdcsr.tasks.catalogue.TASKS`, or a task.
        motion: how targets move, a name in :data:`cdcsr.tasks.target_motion.MOTIONS`; by default the task's.
        quiet: success counts only while the base is near its start; by default the task's.

    Attributes:
        task: with this environment's numbers, the time between its actions among them.
        targets: where they are now, shape (num_envs, 3), in [m].
        target_velocity: how they move now, which no policy sees, shape (num_envs, 3), in [m/s].
        actions_taken: in the episode of each copy, shape (num_envs,).
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: Robot | str = "paper",
        backend: str = "mujoco",
        space: str = "anchor",
        reward: Reward | None = None,
        frame_skip: int = 1,
        max_steps: int | None = None,
        threshold: float | None = None,
        centers: Array | None = None,
        disturbances: Disturbances | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        randomization: Randomization | None = None,
        task: str | Task = "reach",
        motion: MotionName | None = None,
        quiet: bool | None = None,
    ) -> None:
        mode = AutoresetMode(autoreset_mode)
        if mode is AutoresetMode.NEXT_STEP:
            raise CdcsrError(
                "autoreset_mode must be SAME_STEP or DISABLED; NEXT_STEP would waste a step."
            )
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.backend, self.frame_skip = backend, frame_skip
        self.task = make_task(
            task,
            reward_kind=reward,
            max_steps=max_steps,
            threshold=threshold,
            motion=motion,
            quiet=quiet,
            period=self.robot.time_step * frame_skip,
        )
        self.space = make_space(space, self.robot, centers)
        self.max_actions = actions_per_episode(self.task.max_steps, frame_skip)
        self.simulation = make_simulation(self.robot, backend, num_envs)
        self.num_envs = num_envs
        self.single_observation_space = gym.spaces.Box(
            -np.inf, np.inf, (observation_size(self.robot),), np.float64
        )
        self._eta = np.array([servo.eta for servo in self.robot.servos])
        self.single_action_space = gym.spaces.Box(
            -self._eta, np.zeros_like(self._eta), dtype=np.float64
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"autoreset_mode": mode, "render_modes": []}
        self._autoreset = mode is AutoresetMode.SAME_STEP
        self.randomization = randomization
        self._disturbances = disturbances or Disturbances()
        self._channel = Channel(self._disturbances, self.np_random)
        self._motion, self._moving = make_motion(self.task.motion), self.task.motion != "rest"
        self._motion_memory = np.zeros((num_envs, self._motion.size))
        self._memory = self.task.memory(num_envs)
        self._begun = False
        self.targets, self.target_velocity = np.zeros((2, num_envs, 3))
        self.actions_taken = np.zeros(num_envs, dtype=np.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: seeds the one generator that draws all targets, their motions and disturbances.
            options: ``targets``, shape (num_envs, 3), where targets begin instead of drawing it; ``reset_mask``,
                shape (num_envs,), to begin only some episodes.

        Raises:
            CdcsrError: an unknown option, or one of the wrong shape; a negative seed.
        """
        if seed is not None and seed < 0:
            raise CdcsrError(f"seed must not be negative, found {seed}.")
        super().reset(seed=seed)
        if seed is not None:
            self._channel = Channel(self._disturbances, self.np_random)
        given = _read_options(options, targets=(self.num_envs, 3), reset_mask=(self.num_envs,))
        fresh = given.get("reset_mask", np.ones(self.num_envs)).astype(np.bool_)
        observation = self._begin(fresh, given.get("targets"))
        state = self.simulation.state()
        distance = tip_distance(state, self.targets)
        verdict = self.task.judge(state, self.target_velocity, distance, self._memory, count=False)
        return observation, self._info(state, distance, verdict)

    def step(self, actions: Array) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        command = self._channel.command(np.asarray(actions, dtype=np.float64))
        command = np.minimum(
            np.maximum(command, -self._eta), 0
        )  # what np.clip does, in a third of its time
        self.simulation.step(command, self.frame_skip)
        if self._moving:
            for _ in range(self.frame_skip):
                self._motion.advance(
                    self.targets, self.target_velocity, self._motion_memory, self.robot.time_step
                )
        self.actions_taken += 1
        state = self.simulation.state()
        distance = tip_distance(state, self.targets)
        verdict = self.task.judge(state, self.target_velocity, distance, self._memory)
        observation = self._channel.observe(observe(state, self.targets, distance))
        reward = self.task.reward(distance, verdict.rewarded)
        truncated = ~verdict.terminated & (self.actions_taken >= self.max_actions)
        info = self._info(state, distance, verdict)
        done = verdict.terminated | truncated
        if self._autoreset and done.any():
            info |= {
                "final_obs": observation,
                "_final_obs": done,
                "final_info": info.copy(),
                "_final_info": done,
            }
            observation = self._begin(done, None)
        return observation, reward, verdict.terminated.copy(), truncated, info

    def get_state(self) -> dict[str, NDArray[Any]]:
        """All that determines the future: arrays by name, the generators' states among them.

        Robot, task, disturbances, and parameters of the simulation that are not drawn anew for each episode are not in
        it: they are given to the environment that goes on.

        Raises:
            CdcsrError: no episode has begun.
        """
        if not self._begun:
            raise CdcsrError("The environment has no state before its first reset.")
        snapshot = self.simulation.get_snapshot()
        state: dict[str, NDArray[Any]] = {name: rows.copy() for name, rows in self._rows().items()}
        state |= {f"channel.{name}": rows for name, rows in self._channel.get_state().items()}
        state |= {f"simulation.{name}": getattr(snapshot, name) for name in _SNAPSHOT}
        if snapshot.commands is not None:
            state["simulation.commands"] = snapshot.commands
        if self.randomization is not None:
            state |= {
                f"plant.{name}": rows.copy() for name, rows in self.randomization.drawn.items()
            }
            state["plant.generator"] = pack_generator(self.randomization.rng)
        return state | {"generator": pack_generator(self.np_random)}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on, with the next step, from what :meth:`get_state` gave; engine, robot and task must be the same."""
        for name, rows in self._rows().items():
            rows[:] = state[name]
        self._channel.set_state(
            {name: state[f"channel.{name}"] for name in ("received", "under_way", "generator")}
        )
        if (
            self.randomization is not None
        ):  # before the snapshot, as plants say how many commands are under way
            drawn = {name: state[f"plant.{name}"] for name in self.randomization.drawn}
            self.randomization.restore(self.simulation, drawn)
            unpack_generator(self.randomization.rng, state["plant.generator"])
        arrays = {name: state[f"simulation.{name}"] for name in _SNAPSHOT}
        commands = state.get("simulation.commands")
        self.simulation.set_snapshot(
            Snapshot(self.simulation.engine, self.robot.fingerprint, **arrays, commands=commands)
        )
        unpack_generator(self.np_random, state["generator"])
        self._begun = True

    def _rows(self) -> dict[str, NDArray[Any]]:
        """What this object itself knows of the copies: arrays whose first axis is the copy."""
        return {
            "targets": self.targets,
            "target_velocity": self.target_velocity,
            "motion": self._motion_memory,
            "actions_taken": self.actions_taken,
            **{f"task.{name}": count for name, count in self._memory.items()},
        }

    def _begin(self, fresh: Mask, targets: Array | None) -> Array:
        """Start episodes where `fresh`; returns the observations of all copies."""
        ids = np.flatnonzero(fresh)
        self.targets[ids] = (
            self.space.sample(self.np_random, len(ids)) if targets is None else targets[ids]
        )
        if self._moving:
            begun = self._motion.begin(self.np_random, self.targets[ids])
            self.target_velocity[ids], self._motion_memory[ids] = begun
        if self.randomization is not None:
            self.randomization.begin(self.simulation, ids)
        self.simulation.reset(None if fresh.all() else ids)
        self.actions_taken[ids] = 0
        for count in self._memory.values():
            count[ids] = 0
        self._begun = True
        state = self.simulation.state()
        return self._channel.start(observe(state, self.targets), fresh)

    def _info(self, state: State, distance: Array, verdict: Verdict) -> dict[str, Any]:
        info = {"is_success": verdict.success, "distance": distance}
        if self._memory:
            info |= {
                "on_target": verdict.on_target,
                **self.task.report(state, verdict, self._memory),
            }
        return info

    def close_extras(self, **_: Any) -> None:
        self.simulation.close()


class TaskEnv(gym.Env[Array, Array]):
    """One robot at a task: :class:`TaskVectorEnv` with one copy and no autoreset.

    Made by ``gymnasium.make("cdcsr/Reach-v0", ...)``, or Capture or Follow, which takes the same arguments.
    ``reset(options={"target": (x, y, z)})`` sets where the target begins instead of drawing it.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, render_mode: str | None = None, **arguments: Any) -> None:
        self.render_mode = render_mode
        self.batch = TaskVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **arguments)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        given = _read_options(options, target=(3,))
        targets = {"targets": given["target"][None]} if given else None
        observation, info = self.batch.reset(seed=seed, options=targets)
        return observation[0], _first(info)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.batch.step(np.asarray(action)[None])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(info),
        )

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
            raise CdcsrError(
                f"The reset option {name!r} has the shape {shapes[name]}, not {arrays[name].shape}."
            )
    return arrays


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """The info of the only copy."""
    return {name: rows[0].item() for name, rows in info.items()}
