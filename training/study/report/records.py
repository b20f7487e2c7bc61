"""What the runs of the study left behind, read from their CSV and JSON files alone."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json
from training.algorithms.registry import algorithm_order
from training.config.run_description import SCRIPTED, RunDescription
from training.run.metrics import read_metrics

Array = NDArray[np.float64]

JACOBIAN = SCRIPTED
"""The scripted demonstrator: one run of it stands for every space."""
SPACES = {"anchor": "Anchor", "floating": "Floating", "spatter": "Spatter"}
"""The paper's spaces, and their titles."""
DEMONSTRATIONS = 10
"""How many the paper has, unless it varies them."""
REACH, FOLLOW = "reach", "follow"
"""The paper's task, and the evaluation whose file has a row for each step."""


def order(setting: RunDescription) -> tuple[object, ...]:
    """Return a key for sorting: algorithms in the order of their list, then the rest."""
    changes = tuple((name, plain_text(value)) for name, value in setting.changes)
    return (
        algorithm_order(setting.algorithm),
        setting.algorithm,
        setting.preset,
        changes,
        setting.randomize,
        setting.num_demonstrations,
        setting.updates,
        setting.backend,
        setting.space,
        setting.task,
    )


def is_plain(setting: RunDescription) -> bool:
    """Return whether a run is as in the paper: its task, a space of its, ten demonstrations, the
    algorithm's own numbers and no randomization."""
    return is_usual(setting) and not setting.changes


def is_usual(setting: RunDescription) -> bool:
    """Return whether a run is as in the paper, but for changed numbers of the learner."""
    shown = setting.num_demonstrations == DEMONSTRATIONS or setting.algorithm == JACOBIAN
    return is_of_paper(setting) and shown and not setting.randomize


def is_of_paper(setting: RunDescription) -> bool:
    """Return whether a run is of the paper's task in one of its spaces."""
    return setting.task == REACH and setting.space in SPACES


def plain_text(value: object) -> str:
    """Write a changed number of a learner as in tables."""
    return value if isinstance(value, str) else json.dumps(value)


@dataclass(frozen=True)
class Episodes:
    """Episodes of one evaluation, columns of shape (N,)."""

    backend: NDArray[np.str_]
    space: NDArray[np.str_]
    axis: NDArray[np.str_]
    level: Array
    episode: NDArray[np.int64]
    success: NDArray[np.bool_]
    length: Array
    """Simulation steps; a failed episode counts in full."""

    def where(self, **wanted: Any) -> Episodes:
        """Those whose columns equal the values given, ordered by episode."""
        chosen = np.ones(len(self.episode), dtype=bool)
        for name, value in wanted.items():
            chosen &= getattr(self, name) == value
        index = np.flatnonzero(chosen)
        index = index[np.argsort(self.episode[index], kind="stable")]
        return Episodes(**{name: getattr(self, name)[index] for name in self.__dataclass_fields__})

    def __len__(self) -> int:
        return len(self.episode)


@dataclass(frozen=True)
class Run:
    """A finished run."""

    name: str
    setting: RunDescription
    seed: int | None
    budget: str | None
    """Name of the amounts it was run with, if it tells."""
    minutes: float
    updates: int
    environment_steps: int
    versions: Mapping[str, str]
    fingerprint: str
    """Of the robot."""
    curve: list[dict[str, float]]
    """Rows of its metrics that hold a success rate; none for what does not learn by updates."""
    evaluations: Mapping[str, Episodes]
    """By the names of their files."""
    follow: Mapping[str, NDArray[Any]] | None
    """Columns of the target-following evaluation, shape (N,)."""


def load_study(folder: Path) -> list[Run]:
    """All finished runs of a study.

    Args:
        folder: holds one folder for each run, with at least `run.json`.

    Raises:
        CdcsrError: there is no such folder, or one of its files is not as it should be.
    """
    if not folder.is_dir():
        raise CdcsrError(
            f"There is no folder {folder}; give the one that holds the study's runs with --results."
        )
    return [_load_run(path.parent) for path in sorted(folder.glob("*/run.json"))]


def grouped(runs: Iterable[Run], *ignore: str) -> dict[RunDescription, list[Run]]:
    """Runs by their settings, in the order of tables; the settings' fields in `ignore` are left out of account.

    Args:
        runs: any.
        ignore: names of text fields of the settings; they are empty in the keys.
    """
    groups: dict[RunDescription, list[Run]] = {}
    for run in runs:
        groups.setdefault(replace(run.setting, **dict.fromkeys(ignore, "")), []).append(run)
    return dict(sorted(groups.items(), key=lambda item: order(item[0])))


def at_home(runs: Sequence[Run], space: str) -> list[Run]:
    """Those trained in a space; the demonstrator is at home in all."""
    own = [run for run in runs if run.setting.space == space]
    return own or [run for run in runs if run.setting.algorithm == JACOBIAN][:1]


def _load_run(folder: Path) -> Run:
    path = folder / "run.json"
    data = read_json(path)
    try:
        described = {name: value for name, value in data["spec"].items() if name != "budget"}
        description = RunDescription.from_dict(described)
        setting = replace(description, seed=0)
        evaluations = {
            file.stem: read_episodes(file)
            for file in sorted(folder.glob("*.csv"))
            if file.stem not in ("metrics", FOLLOW)
        }
        follow = folder / f"{FOLLOW}.csv"
        return Run(
            name=folder.name,
            setting=setting,
            seed=description.seed,
            budget=data["spec"].get("budget"),
            minutes=float(data["minutes"] or 0),
            updates=int(data["updates"] or 0),
            environment_steps=int(data["environment_steps"] or 0),
            versions={str(k): str(v) for k, v in data["versions"].items()},
            fingerprint=str(data["fingerprint"]),
            curve=[row for row in read_metrics(folder / "metrics.csv") if "success_rate" in row],
            evaluations=evaluations,
            follow=read_follow(follow) if follow.is_file() else None,
        )
    except KeyError as error:
        raise CdcsrError(
            f"{path} has no field {error}; remove the folder, or run it again."
        ) from None
    except (TypeError, ValueError, AttributeError) as error:
        raise CdcsrError(
            f"{path} is not as a run leaves it ({error}); remove the folder, or run it again."
        ) from None


def read_episodes(path: Path) -> Episodes:
    """The episodes in a CSV file of an evaluation.

    Raises:
        CdcsrError: a column is missing, a cell is not what it should be, or episodes are missing.
    """
    columns = _read_columns(
        path,
        {
            "backend": str,
            "space": str,
            "axis": str,
            "level": float,
            "episode": int,
            "success": float,
            "length": float,
        },
    )
    if not np.isin(columns["success"], (0, 1)).all() or not (columns["length"] >= 0).all():
        raise CdcsrError(
            f"{path} has a success that is not 0 or 1, or a length that is none; make it again."
        )
    places = zip(
        *(columns[name].tolist() for name in ("backend", "space", "axis", "level")), strict=True
    )
    cells: dict[tuple[Any, ...], list[int]] = {}
    for cell, episode in zip(places, columns["episode"].tolist(), strict=True):
        cells.setdefault(cell, []).append(episode)
    most = max(map(len, cells.values()), default=0)
    for cell, episodes in cells.items():
        if sorted(episodes) != list(range(most)):
            raise CdcsrError(
                f"{path} should have episodes 0 to {most - 1} of {', '.join(map(str, cell))}; make it again."
            )
    return Episodes(**{**columns, "success": columns["success"] == 1})


def read_follow(path: Path) -> Mapping[str, NDArray[Any]]:
    """Columns of the evaluation of target following.

    Raises:
        CdcsrError: a column is missing, or a cell is no number.
    """
    kinds: dict[str, Callable[[str], Any]] = {"backend": str, "motion": str, "step": int}
    errors = ("tip_error", "base_position_error", "base_attitude_error")
    return _read_columns(path, {**kinds, **dict.fromkeys(errors, float)})


def _read_columns(path: Path, kinds: Mapping[str, Callable[[str], Any]]) -> dict[str, NDArray[Any]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            head, *rows = list(csv.reader(file)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CdcsrError(f"{path} is no CSV file ({error}); make it again.") from None
    missing = [name for name in kinds if name not in head]
    if missing:
        raise CdcsrError(
            f"{path} has no column {', '.join(missing)} (found: {', '.join(head) or 'nothing'}); make it again."
        )
    try:
        return {
            name: np.array(
                [kind(row[head.index(name)]) for row in rows],
                dtype=np.str_ if kind is str else None,
            )
            for name, kind in kinds.items()
        }
    except (ValueError, IndexError) as error:
        raise CdcsrError(
            f"{path} has a row that does not fit its columns ({error}); make it again."
        ) from None
