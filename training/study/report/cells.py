"""Cells of tables, and a table as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cdcsr.simulation.engines import engine_title
from cdcsr.tables import markdown
from training.algorithms.registry import algorithm_title
from training.config.run_description import RunDescription
from training.measure.statistics import Estimate, iqm, over_seeds, rate
from training.study.report.records import Episodes, Run, plain_text

NOT_RUN = "not run"


@dataclass(frozen=True)
class Spread:
    """A mean and the standard deviation around it, over the episodes of all seeds."""

    mean: float
    std: float


Value = str | int | float | Estimate | Spread | None
"""A value of a table; None stands for a run that was not made."""


@dataclass(frozen=True)
class Cell:
    """The results of some seeds of one setting in one evaluation."""

    success: Estimate
    iqm: Estimate | None
    """The interquartile mean over seeds; None for fewer than two."""
    length: Spread
    runs: list[Run]
    episodes: list[Episodes]
    """The episodes of each run."""


@dataclass(frozen=True)
class Table:
    """Rows of values under a head; it knows how it is written."""

    name: str
    """The name of its files."""
    title: str
    note: str
    """A sentence or two about the runs it rests on."""
    head: Sequence[str]
    rows: Sequence[Sequence[Value]]

    def markdown(self) -> str:
        """For reading."""
        return markdown(self.head, [[_text(value) for value in row] for row in self.rows])

    def csv(self) -> str:
        """For computing: an estimate has three columns, a spread two; what was not run is empty."""
        kinds = [_kind(column) for column in zip(*self.rows, strict=True)] or [str] * len(self.head)
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(
            [x for name, kind in zip(self.head, kinds, strict=True) for x in _names(name, kind)]
        )
        for row in self.rows:
            writer.writerow(
                [x for value, kind in zip(row, kinds, strict=True) for x in _numbers(value, kind)]
            )
        return text.getvalue()

    def as_dict(self) -> dict[str, object]:
        """Plain data."""
        rows = [
            [value.__dict__ if isinstance(value, Estimate | Spread) else value for value in row]
            for row in self.rows
        ]
        return {"title": self.title, "note": self.note, "head": list(self.head), "rows": rows}


def measure(
    runs: Sequence[Run], evaluation: str, engine: str | None = None, **wanted: str | float
) -> Cell | None:
    """Return the results of some seeds in one evaluation; None if none of them has it.

    Args:
        runs: seeds of one another.
        evaluation: name of the file.
        engine: the engine it was in; by default, for each run, the one it was trained in.
        wanted: values of other columns, usually `space`, `axis` and `level`.
    """
    found = []
    for run in runs:
        if evaluation in run.evaluations:
            episodes = run.evaluations[evaluation].where(
                backend=engine or run.setting.backend, **wanted
            )
            if len(episodes):
                found.append((run, episodes))
    if not found:
        return None
    success = [episodes.success for _, episodes in found]
    length = np.concatenate([episodes.length for _, episodes in found])
    return Cell(
        rate(success),
        over_seeds(np.array([[one.mean()] for one in success]), iqm) if len(found) > 1 else None,
        Spread(float(length.mean()), float(length.std())),
        [run for run, _ in found],
        [episodes for _, episodes in found],
    )


COST = ("seeds", "updates", "steps", "minutes")
"""Heads of what :func:`cost` gives; steps are the environments', all together."""


def cost(runs: Sequence[Run] | None) -> list[Value]:
    """Return the number of seeds, the updates and steps of each, and the mean minutes."""
    if not runs:
        return [0, None, None, None]
    updates, steps = (
        [getattr(run, name) for run in runs] for name in ("updates", "environment_steps")
    )
    return [
        len(runs),
        _range(updates),
        _range(steps),
        round(float(np.mean([run.minutes for run in runs])), 1),
    ]


def _range(numbers: Sequence[int]) -> str:
    return (
        f"{min(numbers)}" if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"
    )


def who(setting: RunDescription) -> str:
    """Return a setting's algorithm with its changed numbers, domain randomization and starts."""
    parts = [f"{name} = {plain_text(value)}" for name, value in setting.changes]
    if setting.randomize:
        parts.append(
            "randomized plants" + ("" if setting.randomize == 1 else f" × {setting.randomize:g}")
        )
    if setting.soften:
        parts.append("soft cables" + ("" if setting.soften == 1 else f" × {setting.soften:g}"))
    if setting.start != "still":
        parts.append(f"start {setting.start}")
    return ", ".join([algorithm_title(setting.algorithm), *parts])


def trained(setting: RunDescription) -> list[Value]:
    """Return the columns that tell settings apart: algorithm, preset, engine of training."""
    return [who(setting), setting.preset, engine_title(setting.backend)]


def amount(numbers: Iterable[int], noun: str) -> str:
    """Write an amount: "1 seed", "3 seeds", "1 to 3 seeds"."""
    low, high = min(found := list(numbers)), max(found)
    return f"{low} {noun}{'s' * (low != 1)}" if low == high else f"{low} to {high} {noun}s"


TRAINED = ("algorithm", "preset", "trained in")
"""Heads of what :func:`trained` gives."""


def _text(value: Value) -> str:
    if value is None:
        return NOT_RUN
    if isinstance(value, Estimate):
        return f"{value.value:.2f} [{value.low:.2f}, {value.high:.2f}]" + (
            "*" if value.over == "episodes" else ""
        )
    if isinstance(value, Spread):
        return f"{value.mean:.1f} ± {value.std:.1f}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _kind(column: Iterable[Value]) -> type:
    """Return the type of a column; an estimate or a spread may first show in a later row."""
    kinds = [type(value) for value in column if value is not None]
    return next((kind for kind in kinds if kind in (Estimate, Spread)), kinds[0] if kinds else str)


def _names(name: str, kind: type) -> list[str]:
    suffixes = {Estimate: ("", " low", " high"), Spread: (" mean", " std")}
    return [name + suffix for suffix in suffixes.get(kind, ("",))]


def _numbers(value: Value, kind: type) -> list[object]:
    if isinstance(value, Estimate):
        return [f"{x:.6g}" for x in (value.value, value.low, value.high)]
    if isinstance(value, Spread):
        return [f"{x:.6g}" for x in (value.mean, value.std)]
    return (
        ["" if value is None else value]
        if len(_names("", kind)) == 1
        else [""] * len(_names("", kind))
    )
