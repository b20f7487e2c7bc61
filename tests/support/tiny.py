"""Runs, and jobs of the study, that take seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cdcsr import locks
from cdcsr.robot.description import Robot
from training.algorithms.registry import find_algorithm
from training.config.run_description import Changes, RunDescription
from training.networks.actor import Actor
from training.policy import Policy
from training.run.train_options import Train
from training.study.declare.budgets import Budget
from training.study.execute.jobs import Job

Options = dict[str, Any]
"""Keyword arguments of any types."""
FRAME_SKIP = 10
"""Episodes of 25 actions, so that some end within a short run."""
TINY = {
    "batch_size": 32,
    "bc_rollouts": 4,
    "bc_updates": 100,
    "capacity": 20_000,
    "hidden": (16, 16),
    "num_envs": 4,
}
"""Numbers that make learning take seconds."""
CENTERS = np.array([[0.1, 0.2, 2.4]])
"""The targets of the demonstrations of `untrained_policy`; no other policy has them."""
TINY_BUDGET = Budget("tiny", 1, 1, 60, 60, 2, 20, 2)


def tiny_job(
    updates: int = 60, evaluations: tuple[str, ...] = ("nominal",), **options: object
) -> Job:
    """A job of TD3, unless the options, fields of its description, say something else."""
    spec = RunDescription(algorithm="td3", updates=updates, num_demonstrations=1)
    spec = replace(spec, **{"changes": tiny_changes(), **options})
    return Job(spec, evaluations, TINY_BUDGET)


def tiny_changes(algorithm: str = "td3", **numbers: object) -> Changes:
    """The small numbers that an algorithm reads, and others that it must read."""
    known = find_algorithm(algorithm).numbers.model_fields
    small = {name: value for name, value in TINY.items() if name in known}
    return tuple({**small, **numbers}.items())


def tiny_device_run(
    out: Path, demonstrations: Path, algorithm: str = "clasp", **options: Any
) -> Train:
    """Return a run of 80 updates with device cuda; `numbers` are those of the learner."""
    usual = {
        "space": "spatter",
        "frame_skip": FRAME_SKIP,
        "evaluate_every": 40,
        "evaluate_episodes": 4,
        "updates": 80,
    }
    numbers = options.pop("numbers", {})
    return Train(
        out=out,
        demonstrations=demonstrations,
        algorithm=algorithm,
        device="cuda",
        changes=tiny_changes(algorithm, **numbers),
        **{**usual, **options},
    )


def untrained_policy(robot: Robot) -> Policy:
    """Return a policy whose options all differ from the defaults."""
    card = {"name": "p", "backend": "pybullet", "space": "floating", "frame_skip": 5}
    return Policy(Actor(robot, False, (4,), "relu"), robot, CENTERS, card)


def is_held(path: Path) -> bool:
    """Whether a live process holds the lock."""
    return path.exists() and not locks._is_stale(path)
