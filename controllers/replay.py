"""Replay recorded commands open loop in another engine, and compare the paths of the tips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.observation import TIP_POSITION
from controllers.rollout import Episode

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Replayed:
    """The distance of the tips between a replay and its recording."""

    backend: str
    mean: Array
    """The mean over each episode, shape (N,), in [m]."""
    largest: Array
    """The largest in each episode, shape (N,), in [m]."""

    def as_dict(self) -> dict[str, str | float]:
        """Return the numbers that are reported, in [mm]."""
        return {
            "backend": self.backend,
            "episodes": len(self.mean),
            "mean_mm": 1e3 * float(self.mean.mean()),
            "mean_of_worst_episode_mm": 1e3 * float(self.mean.max()),
            "largest_mm": 1e3 * float(self.largest.max()),
        }


def replay(robot: Robot, backend: str, episodes: list[Episode], frame_skip: int = 1) -> Replayed:
    """Send recorded commands to an engine, all episodes side by side.

    Args:
        robot: the description with which they were recorded.
        backend: the engine.
        episodes: episodes that were recorded in any engine.
        frame_skip: how many simulation steps each command is held for.
    """
    num = len(episodes)
    simulation = make_simulation(robot, backend, num)
    lengths = np.array([episode.length for episode in episodes])
    distances = np.full((num, int(lengths.max())), np.nan)
    command = np.zeros((num, robot.num_cables))
    for k in range(distances.shape[1]):
        running = k < lengths
        for i in np.flatnonzero(running):
            command[i] = episodes[i].actions[k]
        simulation.step(command, frame_skip)
        tip = simulation.state().tip_position
        for i in np.flatnonzero(running):
            distances[i, k] = np.linalg.norm(tip[i] - episodes[i].observations[k + 1, TIP_POSITION])
    simulation.close()
    return Replayed(backend, np.nanmean(distances, axis=1), np.nanmax(distances, axis=1))
