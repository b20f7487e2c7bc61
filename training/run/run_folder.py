"""Whose folder it is: a training run takes an empty one, or goes on in its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json
from training.config.run_config import Learner, Train
from training.run.locks import lock

CONFIG = "config.json"


@contextmanager
def claim_folder(folder: Path, identity: dict[str, Any], force: bool) -> Iterator[None]:
    """Make the folder of a run, or make sure that the run in it is this one, and keep other processes out.

    Args:
        folder: where.
        identity: plain data that must be the same for a run to be resumed.
        force: take the folder of another run, whose results go. A folder that holds no run is nobody's to take.

    Raises:
        CdcsrError: the folder holds something else, or cannot be made.
        Busy: another process is at this run.
    """
    _refuse(folder, identity, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CdcsrError(f"Cannot make the folder {folder}: {error.strerror}.") from None
    with lock(folder / ".lock"):
        _refuse(folder, identity, force)  # as whoever held it may have left it
        if force:
            for name in (
                "summary.json",
                "state.safetensors",
                "metrics.csv",
                "policy.json",
                "policy.safetensors",
            ):
                (folder / name).unlink(missing_ok=True)
            for old in (folder / "tensorboard").glob("events.*"):
                old.unlink()
            (folder / "clone" / "policy.json").unlink(missing_ok=True)
        write_json(folder / CONFIG, identity)
        yield


def _refuse(folder: Path, identity: dict[str, Any], force: bool) -> None:
    """Make sure that a folder is new, or this run's, or, with `force`, a run's."""
    if not folder.exists():
        return
    path = folder / CONFIG
    # What starts with a dot is a file that a run killed at its very start was still writing.
    if not folder.is_dir() or (
        not path.is_file() and any(not one.name.startswith(".") for one in folder.iterdir())
    ):
        raise CdcsrError(f"{folder} exists and is not a training run; give another folder.")
    if path.is_file():
        found = read_json(path)
        if not {"algorithm", "learner"} <= found.keys():
            raise CdcsrError(f"{path} is not of a training run; give another folder.")
        if not force:
            refuse_other_run(path, identity)


def refuse_other_run(path: Path, identity: dict[str, Any]) -> None:
    """Make sure that the run whose `config.json` this is has that identity.

    Raises:
        CdcsrError: it has another, or the file cannot be read.
    """
    found = read_json(path)
    # An option younger than the run had the value then that is its default now.
    flat_found, flat_asked = (
        {**_flat(Train(path, learner=Learner()).identity()), **_flat(found)},
        _flat(identity),
    )
    if flat_found != flat_asked:
        differing = sorted(
            k
            for k in flat_found.keys() | flat_asked.keys()
            if flat_found.get(k) != flat_asked.get(k)
        )
        raise CdcsrError(
            f"{path.parent} holds a run with other options ({', '.join(differing)}); give the same ones to resume it, "
            "another folder, or --force to start anew."
        )


def _flat(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        flat |= (
            _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        )
    return flat
