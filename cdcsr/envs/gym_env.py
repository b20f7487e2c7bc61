"""The Gymnasium vector environment over any engine: many robots at any task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.envs.episodes import Episodes
from cdcsr.envs.options import read_reset_options
from cdcsr.envs.rng_state import pack_generator, unpack_generator
from cdcsr.errors import CdcsrError, Diverged, unknown_choice
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.arguments import MOST_COPIES, MOST_SEED, MOST_SKIP, as_floats, check_count
from cdcsr.simulation.contract import Snapshot, State
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.randomization import Randomization
from cdcsr.simulation.turns import taking_turns
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.observation import observation_size, observe
from cdcsr.tasks.spaces import Space, make_space
from cdcsr.tasks.starts import Starts
from cdcsr.tasks.target_motion import MotionName
from cdcsr.tasks.task import Reward, Task, Verdict

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Info = dict[str, Any]
"""Gymnasium's type of infos, options and metadata."""

_SNAPSHOT = ("time", "position", "velocity", "private")
"""The arrays of a snapshot that are always there."""


@taking_turns
class TaskVectorEnv(VectorEnv[Array, Array, NDArray[np.generic]]):
    """Many robots at a task, stepped as one batch by the engine.

    ``gymnasium.make_vec("cdcsr/Reach-v0", num_envs=N, ...)`` makes one; Capture and Follow have
    the same arguments. By default the autoreset mode is SAME_STEP: when an episode ends, the
    observation returned is the first one of the next episode, and the last one of the old episode
    is in ``info["final_obs"]``. In mode NEXT_STEP the next step begins the new episode: the action
    of that copy is ignored and its reward is 0, so it wastes a step. In mode DISABLED a finished
    episode goes on until it is reset. ``info["is_success"]`` and ``info["distance"]`` are of the
    step just made, and where NEXT_STEP began an episode, of its start; the entries that only one
    task has are described there (:meth:`Task.extra_info`).

    Args:
        num_envs: how many robots.
        robot, backend, space, reward, frame_skip, max_steps, threshold, centers, disturbances:
            see :class:`EnvOptions`.
        autoreset_mode: SAME_STEP, NEXT_STEP or DISABLED.
        randomization, task, motion, quiet, start: see :class:`EnvOptions`.

    Attributes:
        task: the task with this environment's numbers, the time between actions among them.
        max_actions: how many actions an episode has at most.
        simulation: the engine.

    Raises:
        CdcsrError: a name is unknown, or a number is out of range.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: Robot | str = "paper",
        backend: str = "mujoco",
        space: str = "anchor",
        reward: Reward | None = None,
        frame_skip: int | None = None,
        max_steps: int | None = None,
        threshold: float | None = None,
        centers: Array | None = None,
        disturbances: Disturbances | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        randomization: Randomization | None = None,
        task: str | Task = "reach",
        motion: MotionName | None = None,
        quiet: bool | None = None,
        start: str | Starts = "still",
    ) -> None:
        check_count("num_envs", num_envs, MOST_COPIES)
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = [mode.value for mode in AutoresetMode]
            raise CdcsrError(unknown_choice("autoreset_mode", autoreset_mode, modes)) from None
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        frame_skip = ruler(self.robot).frame_skip if frame_skip is None else frame_skip
        check_count("frame_skip", frame_skip, MOST_SKIP)
        self.backend, self.frame_skip = backend, frame_skip
        self.task = make_task(
            task,
            self.robot,
            reward_kind=reward,
            max_steps=max_steps,
            threshold=threshold,
            motion=motion,
            quiet=quiet,
            period=self.robot.time_step * frame_skip,
        )
        if randomization is not None and len(randomization.drawn["command_delay"]) != num_envs:
            raise CdcsrError(
                f"The randomization is of {len(randomization.drawn['command_delay'])} copies; "
                f"there are {num_envs} environments."
            )
        self.max_actions = actions_per_episode(self.task.max_steps, frame_skip)
        self._starts = start if isinstance(start, Starts) else Starts(start, self.robot)
        self.start = self._starts.name
        self._starts.check(self.task)
        where = make_space(space, self.robot, centers)
        self._episodes = Episodes(num_envs, self.task, where, self._starts.varies)
        self.simulation = make_simulation(self.robot, backend, num_envs)
        self._set_gym_attributes(num_envs, mode)
        self.randomization = randomization
        self._disturbances = disturbances or Disturbances()
        self._spawn()
        self._begun = False
        self.divergence: Diverged | None = None

    def _set_gym_attributes(self, num_envs: int, mode: AutoresetMode) -> None:
        """Set what Gymnasium asks of every vector environment."""
        self.num_envs = num_envs
        self._lowest, self._highest = self.robot.command_range
        self._shape = (num_envs, self.robot.num_cables)
        self.single_observation_space = gym.spaces.Box(
            -np.inf, np.inf, (observation_size(self.robot),), np.float64
        )
        self.single_action_space = gym.spaces.Box(self._lowest, self._highest, dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"autoreset_mode": mode, "render_modes": []}
        self._mode = mode
        # The copies whose episode the next step begins.
        self._ended = np.zeros(num_envs, dtype=np.bool_)

    def _spawn(self) -> None:
        """Give disturbances and starts random streams of their own, so that targets depend on
        neither."""
        self._channel = Channel(self._disturbances, self.np_random)
        self._start_rng = self.np_random.spawn(1)[0] if self._starts.varies else self.np_random

    @property
    def space(self) -> Space:
        """Where targets are drawn; another space can be set for the episodes that follow."""
        return self._episodes.space

    @space.setter
    def space(self, space: Space) -> None:
        self._episodes.space = space

    @property
    def targets(self) -> Array:
        """Where the targets are now, shape (num_envs, 3), in [m]."""
        return self._episodes.targets

    @property
    def target_velocity(self) -> Array:
        """How the targets move now, shape (num_envs, 3), in [m/s]; no policy observes it."""
        return self._episodes.target_velocity

    @property
    def drift(self) -> Array:
        """The part of that velocity which the robot shares from the start, shape (num_envs, 3)."""
        return self._episodes.drift

    @property
    def actions_taken(self) -> NDArray[np.int64]:
        """How many actions each episode has had, shape (num_envs,)."""
        return self._episodes.actions_taken

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Array, Info]:
        """Begin new episodes.

        Args:
            seed: seeds the one generator that draws all targets, their motions and disturbances.
            options: ``targets``, shape (num_envs, 3), sets where targets begin instead of drawing
                it; ``reset_mask``, shape (num_envs,), chooses which episodes begin.

        Raises:
            CdcsrError: an unknown option, or one of the wrong shape; a negative seed.
        """
        if seed is not None:
            check_count("seed", seed, MOST_SEED, least=0)
        super().reset(seed=seed)
        if seed is not None:
            self._spawn()
        given = read_reset_options(options, targets=(self.num_envs, 3), reset_mask=(self.num_envs,))
        fresh = given.get("reset_mask", np.ones(self.num_envs)).astype(np.bool_)
        if not self._begun and not fresh.all():
            raise CdcsrError("The first reset begins all episodes; leave reset_mask out.")
        observation = self._begin(fresh, given.get("targets"))
        state = self.simulation.state()
        distance, verdict = self._episodes.judge(state, count=False)
        return observation, self._info(state, distance, verdict)

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Mask, Mask, Info]:
        """Advance all robots by one action.

        The episode of a copy that diverges is truncated, without success; the copy is back at the
        start. ``info["diverged"]`` then says which copies did, shape (num_envs,), and the attribute
        `divergence` why.

        Args:
            actions: commands of the servos, shape (num_envs, C), clipped to their range.

        Returns:
            Observation, reward, terminated, truncated and info; their first axis is the robot.

        Raises:
            CdcsrError: no episode has begun, or actions have another shape or are not finite.
        """
        if not self._begun:
            raise CdcsrError("Call reset() before the first step().")
        command = self._channel.command(as_floats("actions", actions, self._shape))
        # Three times as fast as np.clip.
        command = np.minimum(np.maximum(command, self._lowest), self._highest)
        lost, fresh = self._advance(command), self._ended
        self._episodes.advance(self.frame_skip, self.robot.time_step)
        state = self.simulation.state()
        distance, verdict = self._episodes.judge(state)
        if lost.any():
            verdict = verdict.without(lost)
        observation = self._channel.observe(observe(state, self.targets, distance))
        reward = self.task.reward(distance, verdict.rewarded)
        if fresh.any():  # nothing of what these copies did counts
            observation, reward = self._begin(fresh, None), np.where(fresh, 0.0, reward)
            lost &= ~fresh
            state = self.simulation.state()
            distance, verdict = self._episodes.judge(state, count=False)
            verdict = verdict._replace(terminated=verdict.terminated & ~fresh).without(lost)
        truncated = ~verdict.terminated & ((self.actions_taken >= self.max_actions) | lost)
        info = self._info(state, distance, verdict)
        if lost.any():
            info["diverged"] = lost
        done = verdict.terminated | truncated
        if self._mode is AutoresetMode.NEXT_STEP:
            self._ended = done
        elif self._mode is AutoresetMode.SAME_STEP and done.any():
            info |= {
                "final_obs": observation,
                "_final_obs": done,
                "final_info": info.copy(),
                "_final_info": done,
            }
            observation = self._begin(done, None)
        return observation, reward, verdict.terminated.copy(), truncated, info

    def _advance(self, command: Array) -> Mask:
        """Step the engine, put copies that diverge back to the start, and return which did."""
        lost, self.divergence = np.zeros(self.num_envs, dtype=np.bool_), None
        try:
            self.simulation.step(command, self.frame_skip)
        except Diverged as error:
            self.divergence = error
            lost[list(error.copies)] = True
            self.simulation.reset(error.copies)
        return lost

    def get_state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that determines the future, as arrays by name; random generators included.

        Robot, task and disturbances are not in it, nor are parameters of the simulation that are
        not drawn anew for each episode: the environment that goes on must be made with the same.

        Raises:
            CdcsrError: no episode has begun.
        """
        if not self._begun:
            raise CdcsrError("The environment has no state before its first reset.")
        snapshot = self.simulation.get_snapshot()
        state = {name: rows.copy() for name, rows in self._episodes.arrays().items()}
        state |= {f"channel.{name}": rows for name, rows in self._channel.get_state().items()}
        state |= {f"simulation.{name}": getattr(snapshot, name) for name in _SNAPSHOT}
        if snapshot.commands is not None:
            state["simulation.commands"] = snapshot.commands
        if self.randomization is not None:
            drawn = self.randomization.drawn
            state |= {f"plant.{name}": rows.copy() for name, rows in drawn.items()}
            state["plant.generator"] = pack_generator(self.randomization.rng)
        if self._starts.varies:
            state["start.generator"] = pack_generator(self._start_rng)
        if self._mode is AutoresetMode.NEXT_STEP:
            state["ended"] = self._ended.astype(np.int64)
        return state | {"generator": pack_generator(self.np_random)}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what :meth:`get_state` returned; engine, robot and task must be the same."""
        for name, rows in self._episodes.arrays().items():
            rows[:] = state[name]
        self._channel.set_state(
            {name: state[f"channel.{name}"] for name in ("received", "under_way", "generator")}
        )
        if self.randomization is not None:
            # Before the snapshot, as plants say how many commands are under way.
            drawn = {name: state[f"plant.{name}"] for name in self.randomization.drawn}
            self.randomization.restore(self.simulation, drawn)
            unpack_generator(self.randomization.rng, state["plant.generator"])
        arrays = {name: state[f"simulation.{name}"] for name in _SNAPSHOT}
        commands = state.get("simulation.commands")
        self.simulation.set_snapshot(
            Snapshot(self.simulation.engine, self.robot.fingerprint, **arrays, commands=commands)
        )
        if self._starts.varies:
            unpack_generator(self._start_rng, state["start.generator"])
        if self._mode is AutoresetMode.NEXT_STEP:
            self._ended = state["ended"].astype(np.bool_)
        unpack_generator(self.np_random, state["generator"])
        self._begun = True

    def _begin(self, fresh: Mask, targets: Array | None) -> Array:
        """Begin episodes where `fresh`, and return the observations of all copies."""
        ids = np.flatnonzero(fresh)
        if self.randomization is not None:
            self.randomization.begin(self.simulation, ids)
        drift = self._starts.begin(self.simulation, ids, self._start_rng)
        self._episodes.begin(ids, self.np_random, targets, drift)
        self._begun, self._ended = True, self._ended & ~fresh
        return self._channel.start(observe(self.simulation.state(), self.targets), fresh)

    def _info(self, state: State, distance: Array, verdict: Verdict) -> Info:
        info = {"is_success": verdict.success, "distance": distance}
        if self._episodes.counts:
            info["on_target"] = verdict.on_target
            info |= self.task.extra_info(state, self._episodes.counts)
        return info

    def close_extras(self, **_: object) -> None:
        """Release what the engine holds; Gymnasium calls this from `close`."""
        self.simulation.close()
