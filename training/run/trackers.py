"""Trackers of experiments that a run may log to besides its own files: Weights & Biases, trackio.

Neither sends anything: Weights & Biases writes offline into the run's folder, for `wandb sync`, and
trackio into its own folder on this machine, for `trackio show`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Literal, Protocol

TrackerName = Literal["wandb", "trackio"]
PROJECT = "cdcsr"
"""The project's name in a tracker; a run has the name of its folder there."""


class Tracker(Protocol):
    """A run in a tracker; both packages have these two methods."""

    def log(self, metrics: dict[str, float], step: int) -> None:
        """Write numbers by their names."""

    def finish(self) -> None:
        """Write what is left."""


def start_tracker(name: TrackerName, folder: Path, config: Mapping[str, object]) -> Tracker:
    """Begin a run in a tracker.

    Args:
        name: the tracker, which is the name of its package.
        folder: of the run.
        config: the options of the run, as plain data.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    package = import_module(name)
    described = {"project": PROJECT, "name": folder.name, "config": dict(config)}
    if name == "wandb":
        return package.init(**described, dir=str(folder), mode="offline", reinit="create_new")
    return package.init(**described, embed=False, auto_log_gpu=False, auto_log_cpu=False)
