"""Measuring a controller: success and episode length on held-out targets, all episodes as one batch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tasks.catalogue import make_task
from controllers.controller import Controller
from controllers.rollout import rollout
from training.config.seeds import TEST_SEED
from training.measure.plant_axes import SecondPlant
from training.measure.statistics import wilson
from training.policy import Policy

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Result:
    """How a controller did in a batch of episodes, in the order of their targets."""

    success: NDArray[np.bool_]
    """(N,)."""
    length: NDArray[np.int64]
    """(N,) time steps of the robot that the controller is for; a failed episode counts in full."""
    distance: Array
    """(N,) from tip to target at the end, in [m]."""
    targets: Array
    """(N, 3) world frame, in [m]."""

    @property
    def rate(self) -> float:
        """kappa, the share of episodes that succeed."""
        return float(self.success.mean())

    def summary(self) -> dict[str, Any]:
        """The numbers that are reported."""
        low, high = wilson(int(self.success.sum()), len(self.success))
        return {
            "episodes": len(self.success),
            "success_rate": self.rate,
            "success_low": low,
            "success_high": high,
            "length_mean": float(self.length.mean()),
            "length_std": float(self.length.std()),
            "failed": np.flatnonzero(~self.success).tolist(),
        }


def evaluate(
    controller: Controller,
    robot: Robot,
    backend: str,
    space: str,
    episodes: int = 100,
    seed: int = TEST_SEED,
    centers: Array | None = None,
    frame_skip: int = 1,
    disturbances: Disturbances | None = None,
    plant: SecondPlant | None = None,
    task: str = "reach",
) -> Result:
    """Run a controller from the start on targets drawn from a space.

    Args:
        controller: who acts.
        robot: the description of the robot it is for.
        backend: the engine.
        space: the operation space.
        episodes: how many, run as one batch.
        seed: of the targets (and of disturbances): the same seed gives every controller the same ones.
        centers: the demonstrations' targets, shape (n, 3), for Floating and Spatter.
        frame_skip: simulation steps each action is held for.
        disturbances: what goes wrong between policy and robot.
        task: a name in :data:`cdcsr.tasks.catalogue.TASKS`.
        plant: what is simulated, if it is not just `robot`. Given so, a policy acts on a robot it is not for.

    Raises:
        CdcsrError: an unknown engine or space, or no episodes.
    """
    if episodes < 1:
        raise CdcsrError(f"episodes must be at least 1, not {episodes}.")
    max_steps = make_task(task).max_steps
    plant, disturbances = plant or SecondPlant(robot), disturbances or Disturbances()
    if isinstance(controller, Policy) and plant.robot is not robot:
        controller = controller.on(plant.robot)
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
        autoreset_mode="Disabled",
    )
    try:
        if plant.own_settings or plant.own_cables:
            env.simulation.use_own_settings(numbers=plant.own_settings)
        if plant.parameters is not None:
            env.simulation.set_parameters(None, plant.parameters)
        observation, _ = env.reset(seed=seed)
        outcome = rollout(controller, env, observation)
        return Result(
            outcome.success,
            np.where(outcome.success, outcome.length * frame_skip, max_steps),
            outcome.distance,
            outcome.targets,
        )
    finally:
        env.close()
