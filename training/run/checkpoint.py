"""Everything a run needs to go on as if it had never stopped, in one safetensors file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from cdcsr.errors import CdcsrError
from cdcsr.files import JsonObject, note, replacing
from cdcsr.robot.description import Robot, differences, parse_robot
from training.algorithms.td3 import TD3, BackboneNumbers
from training.experience.collector import Collector
from training.experience.mixed_replay import MixedReplay

_META = "run"


class Counters(TypedDict):
    """Where a run stands."""

    update: int
    environment_steps: int
    minutes: float
    recent: list[int]
    """1 for each success of the last episodes, and 0 for each failure."""
    diverged: int
    """How many episodes were dropped so far because the simulation diverged."""


class Parts(NamedTuple):
    """The parts that learning changes; a checkpoint holds all of them."""

    algorithm: TD3[BackboneNumbers]
    replay: MixedReplay
    collector: Collector
    generators: dict[str, np.random.Generator]
    torch_generator: torch.Generator


def save_state(path: Path, parts: Parts, counters: Counters) -> None:
    """Write the state of a run; the file is complete or, if interrupted, still the one before.

    Raises:
        CdcsrError: the file cannot be written.
    """
    tensors: dict[str, torch.Tensor] = {"torch_generator": parts.torch_generator.get_state()}
    for name, module in _modules(parts.algorithm).items():
        tensors |= {f"{name}.{key}": value for key, value in module.state_dict().items()}
    for name, optimizer in _optimizers(parts.algorithm).items():
        for i, state in optimizer.state_dict()["state"].items():
            tensors |= {f"{name}.{i}.{key}": torch.as_tensor(value) for key, value in state.items()}
    # Rows of the ring that hold something; slices share memory, so nothing is copied here.
    for name, buffer in parts.replay.buffers.items():
        tensors |= {
            f"{name}.{key}": torch.from_numpy(rows[: buffer.size])
            for key, rows in buffer.rows.items()
        }
    tensors |= {
        f"env.{key}": torch.from_numpy(np.asarray(value))
        for key, value in parts.collector.state_arrays().items()
    }
    meta: JsonObject = {
        "counters": counters,
        "replays": {
            name: [buffer.position, buffer.size] for name, buffer in parts.replay.buffers.items()
        },
        "updates": parts.algorithm.updates,
        "generators": {name: g.bit_generator.state for name, g in parts.generators.items()},
    }
    write_state(path, tensors, meta, parts.collector.env.robot)


def write_state(
    path: Path, tensors: dict[str, torch.Tensor], meta: JsonObject, robot: Robot
) -> None:
    """Write tensors and plain data; the file is complete or, if interrupted, the one before.

    Raises:
        CdcsrError: the file cannot be written.
    """
    meta = {**meta, "robot": robot.to_toml()}
    meta["digest"] = _digest(tensors, meta)
    rows = {key: value.contiguous() for key, value in tensors.items()}
    with replacing(path) as temporary:
        try:
            save_file(rows, temporary, {_META: json.dumps(meta)})
        except SafetensorError as error:  # the library's own word for an OSError
            raise OSError(str(error)) from None


def load_state(path: Path, parts: Parts) -> Counters:
    """Put a run back to the state in a file; returns its counters.

    Raises:
        CdcsrError: the file is damaged.
    """
    with reading_state(path, parts.collector.env.robot) as (tensors, meta):
        for name, module in _modules(parts.algorithm).items():
            module.load_state_dict(_below(tensors, f"{name}."))
        for name, optimizer in _optimizers(parts.algorithm).items():
            state: dict[int, dict[str, torch.Tensor]] = {}
            for key, value in _below(tensors, f"{name}.").items():
                index, field = key.split(".")
                state.setdefault(int(index), {})[field] = value
            optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
        for name, buffer in parts.replay.buffers.items():
            buffer.position, buffer.size = meta["replays"][name]
            for key, rows in buffer.rows.items():
                rows[: buffer.size] = tensors[f"{name}.{key}"].numpy()
        parts.algorithm.updates = meta["updates"]
        arrays: dict[str, NDArray[Any]] = {
            key: value.numpy() for key, value in _below(tensors, "env.").items()
        }
        parts.collector.load_state_arrays(arrays)
        for name, generator in parts.generators.items():
            generator.bit_generator.state = meta["generators"][name]
        parts.torch_generator.set_state(tensors["torch_generator"])
    return meta["counters"]


def read_meta(path: Path) -> JsonObject:
    """Return the plain data in a file that :func:`write_state` wrote, without its tensors.

    Raises:
        CdcsrError: it is damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            return json.loads(file.metadata()[_META])
    except (OSError, SafetensorError, KeyError, ValueError, TypeError) as error:
        raise CdcsrError(
            f"The saved state {path} is damaged ({type(error).__name__}); start anew with --force."
        ) from None


@contextmanager
def reading_state(path: Path, robot: Robot) -> Iterator[tuple[dict[str, torch.Tensor], JsonObject]]:
    """Read what :func:`write_state` wrote; what goes wrong inside means that it is damaged.

    Raises:
        CdcsrError: it is damaged, or of another robot.
    """
    try:
        with safe_open(path, framework="pt") as file:
            names = list(file.keys())
            tensors = {name: file.get_tensor(name) for name in names}
            meta = json.loads(file.metadata()[_META])
        expected = meta.pop("digest", None)
        if expected is None:
            note(f"{path} is of an older version, without a digest; damage would not be seen.")
        elif expected != _digest(tensors, meta):
            raise ValueError(f"its content has not the digest {str(expected)[:16]}")
        _check_robot(path, meta.get("robot"), robot)
        yield tensors, meta
    except (OSError, SafetensorError, KeyError, ValueError, RuntimeError, TypeError) as error:
        reason = str(error).split("\n")[0]
        raise CdcsrError(
            f"The saved state {path} is damaged ({type(error).__name__}: {reason}); start anew "
            "with --force."
        ) from None


def _check_robot(path: Path, found: str | None, robot: Robot) -> None:
    """Check that a state is of this robot; those of older versions do not tell.

    Raises:
        CdcsrError: it is of another one.
    """
    own = robot if found is None else parse_robot(found, f"The robot of {path}")
    if own.fingerprint != robot.fingerprint:
        raise CdcsrError(f"{path} is of another robot ({differences(own, robot)}).")


def _digest(tensors: dict[str, torch.Tensor], meta: JsonObject) -> str:
    """Return 16 hexadecimal digits of all that a state holds."""
    content = hashlib.sha256(json.dumps(meta, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        content.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        content.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return content.hexdigest()[:16]


def _below(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {
        key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)
    }


def _modules(algorithm: TD3[BackboneNumbers]) -> dict[str, torch.nn.Module]:
    return {
        "actor": algorithm.actor,
        "critics": algorithm.critics,
        "target_actor": algorithm.target_actor,
        "target_critics": algorithm.target_critics,
    }


def _optimizers(algorithm: TD3[BackboneNumbers]) -> dict[str, torch.optim.Optimizer]:
    return {
        "actor_optimizer": algorithm.actor_optimizer,
        "critic_optimizer": algorithm.critic_optimizer,
    }
