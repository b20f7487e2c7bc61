"""Policies that were trained with stable-baselines3, as controllers."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.reading import MOST_TABLE, check_file
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import as_goals, observation_size, observe
from controllers.controller import Conditions, Controller, Target

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

Array = NDArray[np.float64]

_NO_BUFFER = {"buffer_size": 1, "replay_buffer_class": None, "replay_buffer_kwargs": {}}
"""Only training needs these; a buffer of hindsight would ask for an environment."""


class StableBaselines(Controller):
    """A policy that stable-baselines3 saved after training in the environments of this project.

    It observes eq. (1), or the same with goals apart, and acts without noise. Actions are scaled as
    stable-baselines3 scales them, to the action space that is in the file. Loading the file runs
    code that is in it, as stable-baselines3 always does: load only files that you trust.

    Args:
        path: what `model.save` wrote, of SAC, TD3, DDPG or PPO.
        frame_skip: how many simulation steps each action was held for in training; by default the
            robot's own number.

    Raises:
        CdcsrError: stable-baselines3 is not installed, or the file holds no such policy.
    """

    def __init__(self, path: Path | str, frame_skip: int | None = None) -> None:
        self.name, self.frame_skip = Path(path).stem, frame_skip
        self._path, self._model = Path(path), _load(Path(path))

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of the file: equal only for equal files."""
        return hashlib.sha256(self._path.read_bytes()).hexdigest()[:16]

    def begin(self, conditions: Conditions) -> None:
        """Check that the policy fits the robot.

        Raises:
            CdcsrError: its observations or actions have another size.
        """
        robot, model = conditions.robot, self._model
        example = np.zeros(observation_size(robot))
        shown = {name: part.shape for name, part in as_goals(example).items()}
        found = _shape(model.observation_space), _shape(model.action_space)
        expected = shown if isinstance(found[0], dict) else example.shape, (robot.num_cables,)
        if found != expected:
            raise CdcsrError(
                f"The policy in {self._path} has observations and actions of shapes {found[0]} and "
                f"{found[1]}; those of robot {robot.name!r} are {expected[0]} and {expected[1]}."
            )

    def act(self, state: State, target: Target, time: Array) -> Array:
        observation: Array | dict[str, Array] = observe(state, target.position)
        if isinstance(self._model.observation_space, spaces.Dict):
            observation = as_goals(observation)
        action, _ = self._model.predict(observation, deterministic=True)
        return np.asarray(action, dtype=np.float64)


def _shape(space: gymnasium.Space) -> dict[str, tuple[int, ...]] | tuple[int, ...] | None:
    """Return the shape of a space, or those of its parts."""
    if isinstance(space, spaces.Dict):
        return {name: part.shape or () for name, part in space.items()}
    return space.shape


def _load(path: Path) -> BaseAlgorithm:
    check_file(path, MOST_TABLE, "policy")
    try:
        import stable_baselines3
    except ImportError:
        raise CdcsrError(
            f"{path} is a policy of stable-baselines3, which is not installed; "
            "run: pip install stable-baselines3"
        ) from None
    try:
        _check_size(path)
        algorithm = _algorithm(path)
        kind = getattr(stable_baselines3, algorithm)
        return kind.load(path, device="cpu", custom_objects=_NO_BUFFER)
    # The file runs its own code, which may fail in any way.
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        raise CdcsrError(
            f"{path} holds no policy of stable-baselines3 (SAC, TD3, DDPG or PPO): "
            f"{type(error).__name__}: {reason}"
        ) from None


def _check_size(path: Path) -> None:
    """Check how much an archive, and those of PyTorch in it, unpack to, before anything does.

    Raises:
        ValueError: it is more than is allowed.
        Exception: it is no archive.
    """
    with zipfile.ZipFile(path) as archive:
        left = MOST_TABLE - sum(member.file_size for member in archive.infolist())
        for name in archive.namelist() if left >= 0 else ():
            if name.endswith(".pth"):
                with archive.open(name) as file, zipfile.ZipFile(file) as inner:
                    left -= sum(member.file_size for member in inner.infolist())
    if left < 0:
        raise ValueError(f"it unpacks to more than {MOST_TABLE:,} bytes")


def _algorithm(path: Path) -> str:
    """Return the class that saved a file, from the options in it."""
    with zipfile.ZipFile(path) as archive:
        options = json.loads(archive.read("data"))
    module = options["policy_class"]["__module__"]
    if module == "stable_baselines3.sac.policies":
        return "SAC"
    if module == "stable_baselines3.td3.policies":
        return "TD3"  # DDPG is TD3 with other numbers
    if "clip_range" in options:
        return "PPO"
    raise ValueError(f"its policy is of {module}")
