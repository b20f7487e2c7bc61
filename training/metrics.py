"""Where the numbers of a run go while it learns: a CSV file, TensorBoard, and the progress bar."""

from __future__ import annotations

import csv
import time
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

COLUMNS: tuple[str, ...] = (
    "update",
    "environment_steps",
    "minutes",
    "train_success",
    "success_rate",
    "success_low",
    "success_high",
    "length_mean",
    "critic_loss",
    "actor_loss",
    "value",
    "updates_per_second",
)


class Metrics:
    """Appends one row at a time, in a CSV file and as TensorBoard events.

    Args:
        folder: of the run.
        after: when resuming, rows of later updates than this are dropped: they will come again.
    """

    def __init__(self, folder: Path, after: int) -> None:
        self._path = folder / "metrics.csv"
        rows = [row for row in read_metrics(self._path) if row["update"] <= after] if after else []
        with self._path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
        self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=after + 1 if after else None)

    def add(self, row: dict[str, float]) -> None:
        """Write a row; a column that is missing stays empty."""
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, COLUMNS).writerow(row)
        for name, value in row.items():
            if name != "update":
                self._board.add_scalar(name, value, int(row["update"]))

    def close(self) -> None:
        self._board.close()


def read_metrics(path: Path) -> list[dict[str, float]]:
    """The rows of a metrics file; empty cells are left out. No file, no rows."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [{key: float(value) for key, value in row.items() if value} for row in csv.DictReader(file)]


class Meter:
    """Means of the losses since they were last taken."""

    def __init__(self) -> None:
        self._values: dict[str, list[Tensor]] = {}
        self._since = time.monotonic()

    def add(self, metrics: dict[str, Tensor]) -> None:
        for name, value in metrics.items():
            self._values.setdefault(name, []).append(value)

    def take(self) -> dict[str, float]:
        means = {name: float(torch.stack(values).mean()) for name, values in self._values.items()}
        now = time.monotonic()
        means["updates_per_second"] = max(map(len, self._values.values()), default=0) / (now - self._since)
        self._values, self._since = {}, now
        return means
