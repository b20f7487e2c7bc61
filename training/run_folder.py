"""Whose folder it is: a training run takes an empty one, or goes on in its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError
from cdcsr.files import write_json
from training.config import Learner, Train

CONFIG = "config.json"


def claim_folder(folder: Path, identity: dict[str, Any], force: bool) -> None:
    """Make the folder of a run, or make sure that the run in it is this one.

    Args:
        folder: where.
        identity: plain data that must be the same for a run to be resumed.
        force: take the folder of another run, whose results go.

    Raises:
        CdcsrError: the folder holds something else, or cannot be made.
    """
    path = folder / CONFIG
    if folder.exists() and not force:
        if not path.is_file():
            # What starts with a dot is a file that a run killed at its very start was still writing.
            if any(not entry.name.startswith(".") for entry in folder.iterdir()):
                raise CdcsrError(f"{folder} exists and is not a training run; give another folder.")
        else:
            refuse_other_run(path, identity)
    if force:
        for name in ("summary.json", "state.safetensors", "metrics.csv", "policy.json", "policy.safetensors"):
            (folder / name).unlink(missing_ok=True)
        for old in (folder / "tensorboard").glob("events.*"):
            old.unlink()
        (folder / "clone" / "policy.json").unlink(missing_ok=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CdcsrError(f"Cannot make the folder {folder}: {error.strerror}.") from None
    write_json(path, identity)


def refuse_other_run(path: Path, identity: dict[str, Any]) -> None:
    """Make sure that the run whose `config.json` this is has that identity.

    Raises:
        CdcsrError: it has another, or the file cannot be read.
    """
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise CdcsrError(f"{path} cannot be read ({error}); give another folder, or --force.") from None
    # An option younger than the run had the value then that is its default now.
    flat_found, flat_asked = {**_flat(Train(path, learner=Learner()).identity()), **_flat(found)}, _flat(identity)
    if flat_found != flat_asked:
        differing = sorted(k for k in flat_found.keys() | flat_asked.keys() if flat_found.get(k) != flat_asked.get(k))
        raise CdcsrError(
            f"{path.parent} holds a run with other options ({', '.join(differing)}); give the same ones to resume it, "
            "another folder, or --force to start anew."
        )


def _flat(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat
