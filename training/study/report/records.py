"""The finished runs of the study, as the tables and figures use them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.reading import check_name
from training.algorithms.registry import algorithm_order
from training.config.run_description import NEAREST, SCRIPTED, RunDescription
from training.study.declare.budgets import BUDGETS
from training.study.store import Columns, StoredRun, read_results

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
        setting.soften,
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
    return is_of_paper(setting) and shown and not setting.randomized


def is_of_paper(setting: RunDescription) -> bool:
    """Return whether a run is of the paper's task in one of its spaces."""
    return setting.task == REACH and setting.space in SPACES


def shared(runs: Iterable[Run]) -> list[Run]:
    """Return the runs whose seeds share demonstrations."""
    return [run for run in runs if not run.setting.demonstration_seed]


def is_extra(run: Run) -> bool:
    """Return whether a run has a seed beyond those that its budget gives to every method."""
    budget = BUDGETS.get(run.budget or "")
    return budget is not None and (run.seed or 0) >= budget.seeds


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

    def where(self, **wanted: str | float) -> Episodes:
        """Return the episodes whose columns equal the values given, ordered by episode."""
        chosen = np.ones(len(self.episode), dtype=bool)
        for name, value in wanted.items():
            chosen &= getattr(self, name) == value
        index = np.flatnonzero(chosen)
        index = index[np.argsort(self.episode[index], kind="stable")]
        return Episodes(**{one.name: getattr(self, one.name)[index] for one in fields(self)})

    def __len__(self) -> int:
        return len(self.episode)


@dataclass(frozen=True)
class Run:
    """A finished run."""

    name: str
    setting: RunDescription
    """The description that all seeds share; `demonstration_seed` is 1 if each has its own ones."""
    seed: int | None
    budget: str | None
    """Name of the amounts it was run with, if it tells."""
    minutes: float
    updates: int
    environment_steps: int
    versions: Mapping[str, str]
    fingerprint: str
    """The fingerprint of the robot."""
    curve: Mapping[float, float]
    """Success on validation targets by updates; empty for what does not learn by updates."""
    evaluations: Mapping[str, Episodes]
    """Episodes by the names of the evaluations."""
    follow: Columns | None
    """Samples of target following, columns of shape (N,)."""


def load_study(folder: Path) -> list[Run]:
    """Return all finished runs of a study, in the order of their names.

    Args:
        folder: a store of results, or a working folder of the study.

    Raises:
        CdcsrError: there is no such folder, or one of its files is damaged.
    """
    return [_run_of(name, stored) for name, stored in read_results(folder).items()]


def grouped(runs: Iterable[Run], *ignore: str) -> dict[RunDescription, list[Run]]:
    """Group runs by their settings, in the order of tables.

    Args:
        runs: any.
        ignore: text fields of the settings that may differ in a group; empty in the keys.
    """
    groups: dict[RunDescription, list[Run]] = {}
    for run in runs:
        groups.setdefault(replace(run.setting, **dict.fromkeys(ignore, "")), []).append(run)
    return dict(sorted(groups.items(), key=lambda item: order(item[0])))


def at_home(runs: Sequence[Run], space: str) -> list[Run]:
    """Return the runs trained in a space; scripted controllers count in every space."""
    own = [run for run in runs if run.setting.space == space]
    return own or [run for run in runs if run.setting.algorithm in (JACOBIAN, NEAREST)][:1]


def _run_of(name: str, stored: StoredRun) -> Run:
    data = stored.record
    try:
        spec = dict(cast(Mapping[str, object], data["spec"]))
        budget = spec.pop("budget", None)
        description = RunDescription.from_dict(spec)
        versions = cast(Mapping[str, object], data["versions"])
        return Run(
            name=name,
            setting=replace(
                description, seed=0, demonstration_seed=min(description.demonstration_seed, 1)
            ),
            seed=description.seed,
            budget=None if budget is None else str(budget),
            minutes=float(cast(float, data["minutes"])),
            updates=int(cast(int, data["updates"])),
            environment_steps=int(cast(int, data["environment_steps"])),
            versions={name: str(version) for name, version in versions.items()},
            fingerprint=str(data["fingerprint"]),
            curve=_curve(stored.metrics),
            evaluations={one: episodes_of(table) for one, table in stored.evaluations.items()},
            follow=stored.follow,
        )
    except KeyError as error:
        raise CdcsrError(
            f"{stored.source}: run {name} has no field {error}; run it again."
        ) from None
    except (TypeError, ValueError, AttributeError) as error:
        raise CdcsrError(
            f"{stored.source}: run {name} is damaged ({error}); run it again."
        ) from None


def _curve(metrics: Columns) -> dict[float, float]:
    if not {"update", "success_rate"} <= metrics.keys():
        return {}
    updates, rates = (metrics[name].astype(float) for name in ("update", "success_rate"))
    return {x: y for x, y in zip(updates.tolist(), rates.tolist(), strict=True) if y == y}


def episodes_of(columns: Columns) -> Episodes:
    """Return the columns of an evaluation in the types of :class:`Episodes`.

    Raises:
        CdcsrError: an engine or a space has a name that cannot stand in that of a figure's file.
    """
    for kind in ("backend", "space"):
        for name in np.unique(columns[kind]):
            check_name(f"The {kind} of an episode", str(name))
    return Episodes(
        backend=columns["backend"].astype(np.str_),
        space=columns["space"].astype(np.str_),
        axis=columns["axis"].astype(np.str_),
        level=columns["level"].astype(float),
        episode=columns["episode"].astype(np.int64),
        success=columns["success"] == 1,
        length=columns["length"].astype(float),
    )
