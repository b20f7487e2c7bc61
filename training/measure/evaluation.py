"""Measure a controller: success and episode length on held-out targets."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.arguments import MOST_COPIES, check_count
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.starts import Starts
from controllers.controller import Controller
from controllers.rollout import rollout
from training.config.seeds import TEST_SEED
from training.measure.plant_axes import ActualPlant
from training.measure.statistics import wilson

Array = NDArray[np.float64]


class Summary(TypedDict):
    """The numbers of a batch of episodes that are reported."""

    episodes: int
    success_rate: float
    success_low: float
    success_high: float
    length_mean: float
    length_std: float
    failed: list[int]
    diverged: int


@dataclass(frozen=True)
class Result:
    """The outcome of a batch of N episodes, in the order of their targets."""

    success: NDArray[np.bool_]
    """Shape (N,)."""
    length: NDArray[np.int64]
    """In time steps of the controller's own robot, shape (N,); failures count in full."""
    distance: Array
    """From tip to target at the end, shape (N,), in [m]."""
    targets: Array
    """Where the targets were at the start, shape (N, 3), in [m]."""
    diverged: int = 0
    """The number of episodes that failed because the simulation diverged."""

    @property
    def rate(self) -> float:
        """The share of episodes that succeed (the paper's kappa)."""
        return float(self.success.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the success rate (Wilson)."""
        return wilson(int(self.success.sum()), len(self.success))

    def summary(self) -> Summary:
        """Return the numbers that are reported."""
        low, high = self.interval
        return {
            "episodes": len(self.success),
            "success_rate": self.rate,
            "success_low": low,
            "success_high": high,
            "length_mean": float(self.length.mean()),
            "length_std": float(self.length.std()),
            "failed": np.flatnonzero(~self.success).tolist(),
            "diverged": self.diverged,
        }


def evaluate(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    episodes: int = 100,
    seed: int = TEST_SEED,
    centers: Array | None = None,
    frame_skip: int | None = None,
    disturbances: Disturbances | None = None,
    plant: ActualPlant | None = None,
    task: str = "reach",
    start: str = "still",
) -> Result:
    """Measure a controller on targets drawn from a space.

    Args:
        controller: the controller that acts.
        robot: the description of the robot that it is for.
        backend: the engine.
        space: the operation space.
        episodes: how many episodes, run as one batch.
        seed: seeds targets, starts and disturbances; the same seed gives every controller the same
            ones. Training draws bent arms from a bank of another seed.
        centers: the targets of the demonstrations, shape (n, 3), for Floating and Spatter; by
            default the controller's.
        frame_skip: how many simulation steps each action is held for; by default the controller's.
        disturbances: the disturbances between controller and robot.
        plant: the plant that is simulated; by default the robot. On a plant given here a policy
            also acts if the plant's numbers differ from its own robot's.
        task: a name in :data:`cdcsr.tasks.catalogue.TASKS`.
        start: the states in which episodes begin: still, moving or anywhere.

    Raises:
        CdcsrError: an unknown engine or space, or no episodes.
    """
    check_count("episodes", episodes, MOST_COPIES)
    centers = controller.centers if centers is None else centers
    frame_skip = controller.frame_skip if frame_skip is None else frame_skip
    frame_skip = ruler(robot).frame_skip if frame_skip is None else frame_skip
    max_steps = make_task(task, robot).max_steps
    plant, disturbances = plant or ActualPlant(robot), disturbances or Disturbances()
    if plant.robot is not robot:  # the task stays the model's
        pinned = plant.robot.model_copy(update={"scale": ruler(robot).scale})
        plant = replace(plant, robot=pinned)
    if plant.robot is not robot:
        controller = controller.on(plant.robot)
    starts = Starts(start, robot, seed)
    env = _environment(
        plant, backend, space, episodes, frame_skip, max_steps, centers, disturbances, task, starts
    )
    with closing(env):
        observation, _ = env.reset(seed=seed)
        outcome = rollout(controller, env, observation)
    return Result(
        outcome.success,
        np.where(outcome.success, outcome.length * frame_skip, max_steps),
        outcome.distance,
        outcome.targets,
        outcome.diverged,
    )


def _environment(
    plant: ActualPlant,
    backend: str,
    space: str,
    episodes: int,
    frame_skip: int,
    max_steps: int,
    centers: Array | None,
    disturbances: Disturbances,
    task: str,
    starts: Starts,
) -> TaskVectorEnv:
    """Make the environment that simulates a plant; steps are those of the model."""
    if plant.observation_delay:
        disturbances = replace(disturbances, observation_delay=plant.observation_delay)
    env = TaskVectorEnv(
        episodes,
        plant.robot,
        backend,
        space,
        frame_skip=frame_skip * plant.substeps,
        max_steps=max_steps * plant.substeps,
        task=task,
        centers=centers,
        disturbances=disturbances,
        start=starts,
        autoreset_mode="Disabled",
    )
    if plant.parameters is not None:
        env.simulation.set_parameters(None, plant.parameters)
    return env
