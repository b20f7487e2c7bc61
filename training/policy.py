"""A trained policy, as a controller and as files.

A policy is a folder with two files. `policy.safetensors` holds the weights. `policy.json`, the
card, holds all else that the policy needs to act: the robot's description, the network's size, the
targets of the demonstrations and how it was trained. Nothing is ever unpickled. The card's
`format` is 1 for a network without mirror symmetry and 2 for one with it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from copy import copy
from importlib import resources
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.torch import load, save

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import JsonObject, note, read_json, sealed, write_bytes, write_json
from cdcsr.reading import MOST_TABLE, digest, exists, is_file, read_bytes
from cdcsr.robot.description import Robot, differences, parse_robot
from cdcsr.simulation.arguments import as_floats
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import observation_size, observe
from cdcsr.tasks.starts import start_name
from controllers.controller import Conditions, Controller, Target
from training.networks.actor import Activation, Actor

Array = NDArray[np.float64]

_WEIGHTS, _CARD = "policy.safetensors", "policy.json"
_MOST_LAYERS = 64
_FORMATS = {False: 1, True: 2}
"""The file format, by whether the network has mirror symmetry. Older versions refuse 2."""


class Policy(Controller):
    """A learned actor with all that it needs to act.

    Attributes:
        robot: the description it was trained with.
        card: how it was trained, as plain data.
    """

    def __init__(self, actor: Actor, robot: Robot, centers: Array, card: JsonObject) -> None:
        self.actor, self.robot, self.card = actor, robot, card
        self.name, self.task = str(card["name"]), str(card.get("task", "reach"))
        self.space, self.engine = str(card["space"]), str(card["backend"])
        self.frame_skip = int(card["frame_skip"])
        self.start = start_name(str(card.get("start", "still")))  # older cards have no such entry
        self._centers, self._checked = centers, robot

    @property
    def centers(self) -> Array:
        return self._centers

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of the weights: equal only for policies that act bit for bit alike,
        among the policies of one run."""
        return hashlib.sha256(save(self._weights())).hexdigest()[:16]

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: tensor.contiguous() for name, tensor in self.actor.state_dict().items()}

    def begin(self, conditions: Conditions) -> None:
        """Check that the robot is the policy's own.

        Raises:
            CdcsrError: it is another robot.
        """
        robot = conditions.robot
        if robot is self._checked:
            return
        if robot.fingerprint != self.robot.fingerprint:
            raise CdcsrError(
                f"The policy {self.name!r} is for robot {self.robot.name!r} "
                f"({self.robot.fingerprint}), not for {robot.name!r} ({robot.fingerprint}): "
                f"{differences(self.robot, robot)}."
            )
        self._checked = robot

    def act(self, state: State, target: Target, time: Array) -> Array:
        return self._commands(observe(state, target.position))

    def __call__(self, observation: ArrayLike) -> Array:
        """Return the commands for one observation, or for many, without any environment.

        Args:
            observation: eq. (1), see :mod:`cdcsr.tasks.observation`; shape (size,) or (num, size).

        Returns:
            Servo set-points, shape (C,) or (num, C), in [m].

        Raises:
            CdcsrError: the observation has another shape, or a number in it is not finite.
        """
        size = observation_size(self.robot)
        seen = as_floats("observation", observation, (*np.shape(observation)[:-1][:1], size))
        return self._commands(np.atleast_2d(seen)).reshape(*seen.shape[:-1], -1)

    def _commands(self, observations: Array) -> Array:
        """Return the commands for observations of shape (num, size)."""
        with torch.no_grad():
            seen = torch.as_tensor(observations, dtype=torch.float32)
            return self.actor.command(seen).numpy().astype(np.float64)

    def on(self, plant: Robot) -> Policy:
        """Return a copy of this policy that also acts on one plant with other numbers.

        Raises:
            CdcsrError: the plant has other links or cables.
        """
        ours, theirs = (
            [(s.links, s.cable_angles) for s in robot.segments] for robot in (self.robot, plant)
        )
        if ours != theirs:
            raise CdcsrError(
                f"The policy {self.name!r} cannot act on {plant.name!r}: it is for other links or "
                "cables."
            )
        twin = copy(self)
        twin._checked = plant
        return twin

    def save(self, folder: Path) -> None:
        """Write the policy into a folder; make the folder, or overwrite a policy in it."""
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
        weights = save(self._weights())
        write_bytes(folder / _WEIGHTS, weights)
        write_json(folder / _CARD, sealed({**card, "weights_digest": digest(weights)}))


def versions() -> dict[str, str]:
    """Return the versions of the packages on which a policy's actions depend."""
    return {name: version(name) for name in ("cdcsr", "torch", "mujoco", "pybullet", "numpy")}


def load_policy(folder: Path) -> Policy:
    """Read a policy from its folder, or from the folder of a run.

    Raises:
        CdcsrError: there is no policy, or its files are damaged or do not fit each other.
    """
    if not is_file(folder / _CARD) or not is_file(folder / _WEIGHTS):
        raise CdcsrError(
            f"{folder} holds no policy: {_CARD} and {_WEIGHTS} are needed (made by `cdcsr train`)."
        )
    try:
        card = read_json(folder / _CARD)
        weights = _read_weights(folder / _WEIGHTS, card)
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
        _check_size(network["hidden"], len(weights))
        symmetry = card["format"] == _FORMATS[True]
        actor = Actor(
            robot,
            bool(network["with_error"]),
            tuple(network["hidden"]),
            network["activation"],
            symmetry,
        )
        actor.load_state_dict(load(weights))
        centers = np.array(card["centers"], dtype=np.float64).reshape(-1, 3)
        if not len(centers) or not np.isfinite(centers).all():
            raise ValueError("centers must be the targets of its demonstrations")
        if network["activation"] not in get_args(Activation):
            raise ValueError(f"activation {network['activation']!r}")
        policy = Policy(actor, robot, centers, card)
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        RuntimeError,
        ArithmeticError,
        SafetensorError,
    ) as error:
        reason = str(error).split("\n")[0]
        raise CdcsrError(
            f"The policy in {folder} is damaged ({type(error).__name__}: {reason}); copy it or "
            "train it again."
        ) from None
    actor.requires_grad_(False)
    return policy


def _read_weights(path: Path, card: JsonObject) -> bytes:
    """Return the content of the file of the weights.

    Raises:
        CdcsrError: it is not the one that the card was written with.
    """
    data, expected = read_bytes(path, MOST_TABLE, "weights"), card.get("weights_digest")
    if expected is None:
        note(f"{path.parent} is of an older version, without digests; damage would not be seen.")
    elif digest(data) != expected:
        raise CdcsrError(
            f"{path} is damaged: its digest is {digest(data)}, and the card {_CARD} names "
            f"{expected}; copy the policy again, or resume its run."
        )
    return data


def _check_size(hidden: list[int], size: int) -> None:
    """Check that layers of such widths fit into a file of `size` bytes, before any is made."""
    if len(hidden) > _MOST_LAYERS or not all(1 <= width <= size for width in hidden):
        raise ValueError(f"hidden layers {str(hidden)[:60]}")
    if 4 * sum(a * b for a, b in pairwise(hidden)) > size:
        raise ValueError(f"hidden layers {str(hidden)[:60]} for weights of {size} bytes")


def shipped_policies() -> dict[str, Path]:
    """Return the folders of the policies that come with the package, by name."""
    folder = Path(str(resources.files("models"))) / "policies"
    return {path.parent.name: path.parent for path in sorted(folder.glob(f"*/{_CARD}"))}


def find_policy(name: str, others: Iterable[str] = ()) -> Policy:
    """Find a policy by its folder, by the folder of its run, or by the name of a shipped one.

    Args:
        name: which policy.
        others: what else the user could have named, for the error.

    Raises:
        CdcsrError: there is none, or it is damaged.
    """
    shipped = shipped_policies()
    if not exists(name) and name in shipped:
        return load_policy(shipped[name])
    if not exists(name):
        raise CdcsrError(
            unknown_choice("policy", name, [*shipped, *others])
            + " Or give the folder of a policy or a run."
        )
    return load_policy(Path(name))
