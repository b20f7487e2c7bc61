"""Keep in files how a run on a device begins: engines on a GPU do not repeat it to the bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.task import Task
from controllers.rollout import Episode
from training.algorithms.td3 import BackboneNumbers
from training.config.learner import Demonstrated
from training.experience.mixed_replay import MixedReplay
from training.experience.replay import Replay
from training.networks.actor import Actor
from training.run.checkpoint import reading_state, write_state
from training.run.setup import Setup
from training.run.train_options import FIRST, SHOWN


def share_demonstrations(setups: Sequence[Setup]) -> None:
    """Give all runs the same demonstrations, those of the first one.

    Runs that record their own keep them in a file until they are finished.
    """
    first = setups[0]
    if first.config.demonstrations is None:
        paths = [setup.config.out / SHOWN for setup in setups]
        there = [path for path in paths if path.exists()]
        if there:
            first.episodes = _read_shown(there[0], first)
        for path in paths:
            if not path.exists():
                write_state(path, _shown(first.episodes), {}, first.robot)
    for setup in setups[1:]:
        setup.episodes = first.episodes


def _shown(episodes: Sequence[Episode]) -> dict[str, torch.Tensor]:
    """Return demonstrations as tensors; the rows of all episodes follow each other."""
    rows = {
        "observations": np.concatenate([each.observations for each in episodes]),
        "actions": np.concatenate([each.actions for each in episodes]),
        "rewards": np.concatenate([each.rewards for each in episodes]),
        "target": np.array([each.target for each in episodes]),
        "terminated": np.array([each.terminated for each in episodes]),
        "length": np.array([each.length for each in episodes]),
    }
    return {name: torch.from_numpy(x) for name, x in rows.items()}


def _read_shown(path: Path, setup: Setup) -> list[Episode]:
    """Read what :func:`_shown` returned."""
    with reading_state(path, setup.robot) as (tensors, _):
        rows = {name: x.numpy() for name, x in tensors.items()}
        ends = rows["length"].cumsum()
        observations = np.split(rows["observations"], (ends + np.arange(1, len(ends) + 1))[:-1])
        actions, rewards = (np.split(rows[name], ends[:-1]) for name in ("actions", "rewards"))
        parts = zip(observations, actions, rows["target"], rewards, rows["terminated"], strict=True)
        return [Episode(seen, did, at, paid, bool(end)) for seen, did, at, paid, end in parts]


def first_rows(
    setup: Setup, actor: Actor, clone: Actor | None, task: Task, learner: BackboneNumbers
) -> Replay:
    """Return the replay that a run begins with; a run that goes on has it in a file."""
    path = setup.config.out / FIRST
    if path.exists():
        return _read_first(path, setup, learner)

    def actions(observations: NDArray[np.float64]) -> NDArray[np.float32]:
        assert clone is not None
        with torch.no_grad():
            return clone.act(torch.as_tensor(observations, dtype=torch.float32)).numpy()

    share = learner.kept_share if isinstance(learner, Demonstrated) else 0.0
    known = None if clone is None else actions
    episodes = setup.first_episodes(actor, clone)
    needed = max(1, sum(len(episode.observations) for episode in episodes))
    small = learner.changed(capacity=needed)
    replay = MixedReplay(setup.robot, task, small, known, share)
    replay.prefill(episodes)
    filled = replay.buffers["kept" if share > 0 else "replay"]
    rows = {name: torch.from_numpy(x[: filled.size]) for name, x in filled.rows.items()}
    if filled.size:
        write_state(path, rows, {}, setup.robot)
    return filled


def _read_first(path: Path, setup: Setup, learner: BackboneNumbers) -> Replay:
    """Read what :func:`first_rows` wrote."""
    with reading_state(path, setup.robot) as (tensors, _):
        sizes = observation_size(setup.robot), setup.robot.num_cables
        num = len(tensors["reward"])
        found = Replay(num, *sizes, learner.discount, learner.return_steps)
        found.size = num
        for name, rows in found.rows.items():
            rows[:] = tensors[name].numpy()
    return found
