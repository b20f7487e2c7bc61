"""Where the numbers of a run go while it learns: a CSV file, TensorBoard, a tracker if one is
asked for, and the progress bar."""

from __future__ import annotations

import os
import socket
import time
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from cdcsr.errors import CdcsrError, cannot_write
from cdcsr.files import write_text
from cdcsr.reading import exists
from cdcsr.tables import csv_text, read_csv_rows
from training.run.trackers import Tracker

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
    "diverged",
)


class Metrics:
    """Adds one row at a time to a CSV file, which is always complete, and to TensorBoard events.

    Args:
        folder: of the run.
        after: when resuming, rows of later updates than this are dropped: they will come again.
        tracker: gets the rows too.

    Raises:
        CdcsrError: a file cannot be written.
    """

    def __init__(self, folder: Path, after: int, tracker: Tracker | None = None) -> None:
        self._path, self._tracker = folder / "metrics.csv", tracker
        old = _rows(self._path) if after else []
        self._rows = [row for row in old if float(row["update"]) <= after]
        self._write()
        self._board = _Events(folder / "tensorboard", after)

    def add(self, row: dict[str, float]) -> None:
        """Write a row; a column that is missing stays empty."""
        self._rows.append({name: str(value) for name, value in row.items()})
        self._write()
        step = int(row["update"])
        values = {name: value for name, value in row.items() if name != "update"}
        self._board.add(step, values)
        if self._tracker is not None:
            self._tracker.log(values, step=step)

    def close(self) -> None:
        """Let the tracker write what is left."""
        if self._tracker is not None:
            self._tracker.finish()

    def _write(self) -> None:
        """Write all rows; without any there is no file, so that a file that lost them is seen."""
        if self._rows:
            lines = [[row.get(name, "") for name in COLUMNS] for row in self._rows]
            write_text(self._path, csv_text(COLUMNS, lines))
            return
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_write(self._path, error) from None


class _Events:
    """TensorBoard events, written in this thread: its own writer prints tracebacks in another one.

    Args:
        folder: where the file of events is made.
        after: events of later updates than this, in older files, do not count; 0 for a new run.
    """

    def __init__(self, folder: Path, after: int) -> None:
        # Here, so that reading metrics needs no TensorBoard; by name, as it has no types.
        self._events = import_module("tensorboard.compat.proto.event_pb2")
        self._summaries = import_module("tensorboard.compat.proto.summary_pb2")
        name = f"events.out.tfevents.{time.time():.0f}.{socket.gethostname()}.{os.getpid()}"
        self._path = folder / name
        self._write(file_version="brain.Event:2")
        if after:
            begun = self._events.SessionLog(status=self._events.SessionLog.START)
            self._write(step=after + 1, session_log=begun)

    def add(self, step: int, values: dict[str, float]) -> None:
        """Write numbers by their names."""
        summary = self._summaries.Summary()
        for tag, value in values.items():
            summary.value.add(tag=tag, simple_value=value)
        self._write(step=step, summary=summary)

    def _write(self, **fields: object) -> None:
        from tensorboard.summary.writer.record_writer import RecordWriter

        event = self._events.Event(wall_time=time.time(), **fields)
        try:
            self._path.parent.mkdir(exist_ok=True)
            with self._path.open("ab") as file:
                RecordWriter(file).write(event.SerializeToString())
        except OSError as error:
            raise cannot_write(self._path, error) from None


def read_metrics(path: Path) -> list[dict[str, float]]:
    """The rows of a metrics file; empty cells are left out. No file, no rows.

    Raises:
        CdcsrError: it is damaged.
    """
    return [{key: float(value) for key, value in row.items() if value} for row in _rows(path)]


def _rows(path: Path) -> list[dict[str, str]]:
    """The same, as they are written."""
    if not exists(path):
        return []
    try:
        head, lines = read_csv_rows(path)
        rows = [dict(zip(head, line, strict=True)) for line in lines]
        for row in rows:
            _ = float(row["update"]), [float(value) for value in row.values() if value]
    except (ValueError, KeyError) as error:
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
