"""A trained policy as files, and as a Controller. Nothing is unpickled: weights are safetensors, the rest is JSON."""

from __future__ import annotations

import hashlib
import json
from copy import copy
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import write_bytes, write_json
from cdcsr.robot.description import Robot, parse_robot
from controllers.controller import Controller
from training.networks.actor import Activation, Actor

Array = NDArray[np.float64]

_WEIGHTS, _CARD = "policy.safetensors", "policy.json"
_FORMATS = {False: 1, True: 2}
"""File format: 1 without mirror symmetry, 2 with it. Older versions refuse 2."""


class Policy(Controller):
    """A learned actor with all it needs to act: robot, scaling, and how it came to be.

    Attributes:
        name: what it is called in tables.
        robot: the description it was trained with.
        centers: the demonstrations' targets, shape (n, 3): what Floating and Spatter surround.
        card: how it was trained, as plain data.
    """

    def __init__(self, actor: Actor, robot: Robot, centers: Array, card: dict[str, Any]) -> None:
        self.actor, self.robot, self.centers, self.card = actor, robot, centers, card
        self.name = str(card["name"])
        self._checked = robot

    @property
    def frame_skip(self) -> int:
        """Simulation steps each action is held for."""
        return int(self.card["frame_skip"])

    @property
    def task(self) -> str:
        """The task it was trained for."""
        return str(self.card.get("task", "reach"))

    @property
    def digest(self) -> str:
        """Of the weights: of policies of one run, equal for those that act alike to the bit."""
        return hashlib.sha256(save(self._weights())).hexdigest()[:16]

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: tensor.contiguous() for name, tensor in self.actor.state_dict().items()}

    def act(self, env: TaskVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
        if env.robot is not self._checked:
            self._check(env.robot)
        with torch.no_grad():
            return (
                self.actor.command(torch.as_tensor(observation, dtype=torch.float32))
                .numpy()
                .astype(np.float64)
            )

    def on(self, plant: Robot) -> Policy:
        """This policy, made to act on one robot that it is not for. It goes on refusing all others.

        Raises:
            CdcsrError: that robot has other links or cables.
        """
        ours, theirs = (
            [(s.links, s.cables.angles_deg) for s in robot.segments]
            for robot in (self.robot, plant)
        )
        if ours != theirs:
            raise CdcsrError(
                f"The policy {self.name!r} cannot act on {plant.name!r}: its links or cables are others."
            )
        twin = copy(self)
        twin._checked = plant
        return twin

    def _check(self, robot: Robot) -> None:
        if robot.fingerprint != self.robot.fingerprint:
            raise CdcsrError(
                f"The policy {self.name!r} is for robot {self.robot.name!r} ({self.robot.fingerprint}), not for "
                f"{robot.name!r} ({robot.fingerprint})."
            )
        self._checked = robot

    def save(self, folder: Path) -> None:
        """Write the policy into a folder, made if missing; a policy that is there is replaced."""
        actor = self.actor
        card = {
            **self.card,
            "format": _FORMATS[actor.mirror_symmetry is not None],
            "robot": self.robot.name,
            "robot_fingerprint": self.robot.fingerprint,
            "robot_description": self.robot.to_toml(),
            "centers": self.centers.tolist(),
            "network": {
                "with_error": actor.encoder.with_error,
                "hidden": [
                    layer.out_features for layer in actor.net if isinstance(layer, torch.nn.Linear)
                ][:-1],
                "activation": "tanh" if isinstance(actor.net[1], torch.nn.Tanh) else "relu",
            },
            "versions": versions(),
        }
        write_bytes(folder / _WEIGHTS, save(self._weights()))
        write_json(folder / _CARD, card)


def versions() -> dict[str, str]:
    """Those of the packages that decide what a policy does."""
    return {name: version(name) for name in ("cdcsr", "torch", "mujoco", "pybullet", "numpy")}


def load_policy(folder: Path) -> Policy:
    """Read a policy from its folder, or from the folder of a run.

    Raises:
        CdcsrError: there is no policy, or its files are damaged or do not belong together.
    """
    if not (folder / _CARD).is_file() or not (folder / _WEIGHTS).is_file():
        raise CdcsrError(
            f"{folder} holds no policy: {_CARD} and {_WEIGHTS} are needed (made by `cdcsr train`)."
        )
    try:
        card = json.loads((folder / _CARD).read_text("utf-8"))
        if card["format"] not in _FORMATS.values():
            raise CdcsrError(
                f"{folder / _CARD} has format {card['format']}; this version reads formats 1 and 2."
            )
        robot = parse_robot(card["robot_description"], str(folder / _CARD))
        if robot.fingerprint != card["robot_fingerprint"]:
            raise CdcsrError(
                f"{folder / _CARD}: the robot's description does not match its fingerprint."
            )
        network = card["network"]
        symmetry = card["format"] == _FORMATS[True]
        actor = Actor(
            robot,
            bool(network["with_error"]),
            tuple(network["hidden"]),
            network["activation"],
            symmetry,
        )
        actor.load_state_dict(load_file(folder / _WEIGHTS))
        centers = np.array(card["centers"], dtype=np.float64).reshape(-1, 3)
        if not len(centers) or not np.isfinite(centers).all():
            raise ValueError("centers must be the targets of its demonstrations")
        if network["activation"] not in get_args(Activation):
            raise ValueError(f"activation {network['activation']!r}")
        _ = str(card["space"]), str(card["backend"])
        policy = Policy(actor, robot, centers, card)
        _ = policy.frame_skip
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RuntimeError,
        SafetensorError,
    ) as error:
        reason = str(error).split("\n")[0]
        raise CdcsrError(
            f"The policy in {folder} is damaged ({type(error).__name__}: {reason}); copy or train it anew."
        ) from None
    actor.requires_grad_(False)
    return policy


def find_policy(name: str) -> Policy:
    """A policy by its folder, by the folder of its run, or by the name of a shipped one.

    Raises:
        CdcsrError: there is none, or it is damaged.
    """
    shipped = Path(str(resources.files("models"))) / "policies"
    if not Path(name).exists() and (shipped / name / _CARD).is_file():
        return load_policy(shipped / name)
    if not Path(name).exists():
        names = (
            [path.name for path in shipped.iterdir() if (path / _CARD).is_file()]
            if shipped.is_dir()
            else []
        )
        raise CdcsrError(
            unknown_choice("policy", name, names) + " Or give the folder of a policy or a run."
        )
    return load_policy(Path(name))
