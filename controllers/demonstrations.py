"""Record demonstrations of a controller, and save and load them as Minari datasets."""

from __future__ import annotations

import copy
import hashlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.tasks.observation import TARGET
from controllers.controller import Controller
from controllers.dataset_files import no_demonstrations, read_metadata, seal_dataset
from controllers.rollout import Episode, rollout

if TYPE_CHECKING:
    from minari import EpisodeData


def digest(episodes: Sequence[Episode]) -> str:
    """Return 16 hexadecimal digits that are equal only for equal episodes."""
    data = hashlib.sha256()
    for episode in episodes:
        for values in (episode.observations, episode.actions, episode.rewards):
            data.update(np.ascontiguousarray(values).tobytes())
    return data.hexdigest()[:16]


def record(
    controller: Controller, env: TaskVectorEnv, num: int, seed: int
) -> tuple[list[Episode], int, int]:
    """Record successful episodes of a controller; in place of failed ones new targets are drawn.

    Args:
        controller: the demonstrator.
        env: an environment with autoreset disabled.
        num: how many successful episodes.
        seed: seeds the targets.

    Returns:
        The episodes in the order of their targets, how many episodes failed, and how many of those
        because the simulation diverged.

    Raises:
        CdcsrError: fewer than one in ten of the episodes succeeds.
    """
    episodes: list[Episode] = []
    failed = diverged = 0
    observation, _ = env.reset(seed=seed)
    while True:
        batch = rollout(controller, env, observation)
        failed += int((~batch.success).sum())
        diverged += batch.diverged
        episodes += batch.successes()
        if len(episodes) >= num:
            return episodes[:num], failed, diverged
        if failed > 10 * max(num, env.num_envs):
            raise CdcsrError(
                f"The controller {controller.name!r} reached {len(episodes)} of "
                f"{len(episodes) + failed} targets in the space {env.space.name!r} ({diverged} "
                "episodes diverged); move or shrink the robot's workspace."
            )
        observation, _ = env.reset()


def save(
    folder: Path, episodes: list[Episode], env: TaskVectorEnv, controller: str, name: str
) -> None:
    """Write a Minari dataset (hdf5) with the id `name` into an existing, empty folder.

    The robot's description is in it, in the metadata and in the environment that Minari recovers.
    HDF5 ends the process when a disk is full, so it writes into memory.

    Raises:
        OSError: the disk is full, or the folder may not be written to.
    """
    import h5py
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    spec = copy.deepcopy(gymnasium.spec(f"cdcsr/{env.task.kind.capitalize()}-v0"))
    spec.kwargs = {
        "task": env.task.name,
        "robot": env.robot.to_toml(),
        "backend": env.backend,
        "space": env.space.name,
        "start": env.start,
        "frame_skip": env.frame_skip,
    }
    storage = MinariStorage.new(
        folder / "data", env.single_observation_space, env.single_action_space, spec
    )
    storage.update_metadata(
        {
            "dataset_id": name,
            "minari_version": minari.__version__,
            "algorithm_name": controller,
            "description": f"Successful episodes of {env.task.name!r} by a cable-driven continuum "
            "space robot.",
            "robot": env.robot.name,
            "robot_fingerprint": env.robot.fingerprint,
            "robot_description": env.robot.to_toml(),
            "task": env.task.name,
            "backend": env.backend,
            "space": env.space.name,
            "start": env.start,
            "frame_skip": env.frame_skip,
            "threshold": env.task.threshold,
        }
    )
    buffers = []
    for i, episode in enumerate(episodes):
        last = np.arange(1, episode.length + 1) == episode.length
        buffers.append(
            EpisodeBuffer(
                id=i,
                observations=list(episode.observations),
                actions=list(episode.actions),
                rewards=list(episode.rewards),
                terminations=list(last & episode.terminated),
                truncations=list(last & (not episode.terminated)),
            )
        )
    content = io.BytesIO()
    h5py.File(content, "w", track_order=True).close()
    storage._file_path, path = content, storage._file_path  # type: ignore[attr-defined]
    storage.update_episodes(buffers)
    path.write_bytes(content.getvalue())
    storage.update_metadata({"dataset_size": storage.get_size()})
    seal_dataset(folder)


def load(
    folder: Path,
    robot_fingerprint: str,
    frame_skip: int = 1,
    task: str | None = None,
    start: str | None = None,
    threshold: float | None = None,
) -> list[Episode]:
    """Read the episodes of a dataset that :func:`save` wrote.

    Args:
        folder: the dataset.
        robot_fingerprint: identifies the robot that it must be of.
        frame_skip: how many simulation steps each action must have been held for.
        task: the task that it must be of; by default any.
        start: the start that it must be of; by default any.
        threshold: the threshold in [m] that its task must have; by default any.

    Raises:
        CdcsrError: it is no such dataset, or it is of another robot, frame skip, task, start or
            threshold.
    """
    from minari import MinariDataset

    try:
        metadata = read_metadata(folder)
        dataset = MinariDataset(folder / "data")
        found = metadata["robot_fingerprint"], metadata["frame_skip"], metadata["task"]
        stored = list(dataset.iterate_episodes())
        _check_shapes(stored)
    except CdcsrError:
        raise
    # A damaged file of an older version, without digests, fails in many ways.
    except Exception as error:
        raise no_demonstrations(folder, error) from None
    if found[0] != robot_fingerprint:
        raise CdcsrError(
            f"The demonstrations in {folder} are of robot {metadata['robot']!r} ({found[0]}), not "
            f"of the robot asked for ({robot_fingerprint}); record new ones with "
            "`cdcsr demonstrate`."
        )
    if found[1] != frame_skip:
        raise CdcsrError(
            f"The demonstrations in {folder} have frame_skip {found[1]}, not {frame_skip}."
        )
    if task is not None and found[2] != task:
        raise CdcsrError(
            f"The demonstrations in {folder} are of the task {found[2]!r}, not {task!r}; record "
            f"some with `cdcsr demonstrate --task {task}`."
        )
    begun = metadata.get("start", "still")  # older datasets have no such entry
    if start is not None and begun != start:
        raise CdcsrError(
            f"The demonstrations in {folder} begin {begun!r}, and only those that begin {start!r} "
            f"can be used here; record some with `cdcsr demonstrate --start {start}`."
        )
    near = metadata.get("threshold", threshold)  # older datasets have no such entry
    if threshold is not None and near != threshold:
        raise CdcsrError(
            f"The demonstrations in {folder} have a threshold of {near:g} m, not {threshold:g} m; "
            "record some with the same --threshold."
        )
    return [
        Episode(
            np.asarray(e.observations),
            np.asarray(e.actions),
            np.asarray(e.observations)[0, TARGET],
            np.asarray(e.rewards, dtype=np.float64),
            bool(np.asarray(e.terminations)[-1]),
        )
        for e in stored
    ]


def _check_shapes(stored: Sequence[EpisodeData]) -> None:
    """Check that arrays belong together and are finite.

    Raises:
        ValueError: they are not.
    """
    if not stored:
        raise ValueError("it has no episodes")
    for number, episode in enumerate(stored):
        seen, done = np.asarray(episode.observations), np.asarray(episode.actions)
        paid, ends = np.asarray(episode.rewards), np.asarray(episode.terminations)
        length = len(done)
        shapes = (seen.shape[:1], done.shape[:1], paid.shape, ends.shape)
        if not length or shapes != ((length + 1,), (length,), (length,), (length,)):
            raise ValueError(f"the arrays of episode {number} have the lengths {shapes}")
        if not all(np.isfinite(rows).all() for rows in (seen, done, paid)):
            raise ValueError(f"episode {number} has numbers that are not finite")
