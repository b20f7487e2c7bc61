"""What a training run keeps in its folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cdcsr.files import WorkingFolder
from training.config.run_config import Learner, Train

RUN_FOLDER = WorkingFolder(
    "a training run",
    record="config.json",
    fields=frozenset({"algorithm", "learner"}),
    results=(
        "summary.json",
        "state.safetensors",
        "metrics.csv",
        "policy.json",
        "policy.safetensors",
        "tensorboard/events.*",
        "clone/policy.json",
    ),
)


def older_defaults() -> dict[str, Any]:
    """Return the values of options that the record of an older run may lack: an option that is
    younger than the run had the value that is its default now."""
    return Train(Path("run"), learner=Learner()).identity()
