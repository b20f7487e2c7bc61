"""Where the numbers of a run go while it learns: a CSV file, TensorBoard, and the progress bar."""

from __future__ import annotations

import csv
import io
import time
from pathlib import Path
from typing import TYPE_CHECKING

from cdcsr.errors import CdcsrError
from cdcsr.files import write_text

if TYPE_CHECKING:
    from torch import Tensor

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
        from torch.utils.tensorboard import (
            SummaryWriter,  # here, so that reading metrics needs no torch
        )

        self._path = folder / "metrics.csv"
        kept = [row for row in _rows(self._path) if float(row["update"]) <= after] if after else []
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS)
        writer.writeheader()
        writer.writerows(kept)
        write_text(self._path, text.getvalue())
        self._board = SummaryWriter(
            str(folder / "tensorboard"), purge_step=after + 1 if after else None
        )

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
    """The rows of a metrics file; empty cells are left out. No file, no rows.

    Raises:
        CdcsrError: it is damaged.
    """
    return [{key: float(value) for key, value in row.items() if value} for row in _rows(path)]


def _rows(path: Path) -> list[dict[str, str]]:
    """The same, as they are written."""
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            _ = float(row["update"]), [float(value) for value in row.values() if value]
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise CdcsrError(
            f"{path} is damaged ({error}); delete it, and what it says of the past is lost."
        ) from None
    return rows


class Meter:
    """Means of the losses since they were last taken."""

    def __init__(self) -> None:
        self._values: dict[str, list[Tensor]] = {}
        self._since = time.monotonic()

    def add(self, metrics: dict[str, Tensor]) -> None:
        for name, value in metrics.items():
            self._values.setdefault(name, []).append(value)

    def take(self) -> dict[str, float]:
        import torch

        means = {name: float(torch.stack(values).mean()) for name, values in self._values.items()}
        now = time.monotonic()
        means["updates_per_second"] = max(map(len, self._values.values()), default=0) / (
            now - self._since
        )
        self._values, self._since = {}, now
        return means
