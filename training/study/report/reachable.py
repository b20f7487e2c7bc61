"""Success on reachable targets, and lengths of episodes relative to the demonstrator's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from training.measure.statistics import rate
from training.study.report.cells import COST, TRAINED, Table, Value, cost, measure, trained
from training.study.report.records import (
    DEMONSTRATIONS,
    JACOBIAN,
    SPACES,
    Episodes,
    Run,
    at_home,
    grouped,
    is_of_paper,
    is_plain,
    is_usual,
)
from training.study.report.table_parts import basis

SOONEST = "best of all runs"
"""Name of the row of the shortest episodes."""
_HEAD = ("space", "reachable", *TRAINED, "κ of reachable", "length over the demonstrator's", *COST)


def beside_demonstrator(runs: Sequence[Run]) -> Table:
    """Return success on the held-out targets that any run reaches, and relative lengths.

    Both are in the space and engine of training.
    """
    chosen = [run for run in runs if is_usual(run.setting)]
    rows: list[list[Value]] = []
    for space in SPACES:
        known = reachable(runs, space)
        for setting, group in grouped(chosen, "space").items():
            seeds = at_home(group, space)
            cell = measure(seeds, "nominal", space=space)
            if cell is None:
                continue
            found = [one.success[np.isin(one.episode, known)] for one in cell.episodes]
            shares = [
                share
                for run, one in zip(cell.runs, cell.episodes, strict=True)
                if (share := _length_over(one, _demonstrator(runs, run.setting.backend, space)))
                is not None
            ]
            total = len(np.unique(cell.episodes[0].episode))
            rows.append(
                [
                    SPACES[space],
                    f"{len(known)} of {total}",
                    *trained(setting),
                    rate(found) if len(known) else None,
                    round(float(np.mean(shares)), 3) if shares else None,
                    *cost(seeds),
                ]
            )
        rows += _soonest(runs, space, known)
    note = basis(chosen) + (
        " Reachable are the targets that any run of the study reaches in time, in any engine."
        " Lengths are compared over the targets that both the policy and the demonstrator reach,"
        " and averaged over seeds. The last row of a space takes, target by target, the shortest"
        " episode of all runs."
    )
    return Table("reachable", "Beside the demonstrator", note, _HEAD, rows)


def reachable(runs: Sequence[Run], space: str) -> NDArray[np.int64]:
    """Return the held-out targets of a space that any run reaches, undisturbed, in any engine.

    Only runs with ten demonstrations count: Floating and Spatter lie around their targets.
    """
    found = [episodes.episode[episodes.success] for episodes in _found(runs, space)]
    return np.unique(np.concatenate(found)) if found else np.empty(0, np.int64)


def _found(runs: Sequence[Run], space: str) -> Iterator[Episodes]:
    """Yield the undisturbed episodes of each of those runs, in any engine."""
    for run in runs:
        if (
            is_of_paper(run.setting)
            and run.setting.num_demonstrations == DEMONSTRATIONS
            and "nominal" in run.evaluations
        ):
            yield run.evaluations["nominal"].where(space=space)


def _soonest(runs: Sequence[Run], space: str, known: NDArray[np.int64]) -> list[list[Value]]:
    """Return a row of the shortest episode of all, target by target."""
    demonstrator = _demonstrator(runs, "mujoco", space)
    if demonstrator is None:
        return []
    both = demonstrator.success & np.isin(demonstrator.episode, known)
    if not both.any():
        return []
    found = list(_found(runs, space))
    shortest = {
        target: min(
            one.length[(one.episode == target) & one.success].min(initial=np.inf) for one in found
        )
        for target in known
    }
    share = (
        np.mean([shortest[target] for target in demonstrator.episode[both]])
        / demonstrator.length[both].mean()
    )
    total = len(np.unique(demonstrator.episode))
    name, *rest = (SOONEST, *"-" * (len(TRAINED) - 1))
    return [
        [
            SPACES[space],
            f"{len(known)} of {total}",
            name,
            *rest,
            "-",
            round(float(share), 3),
            *"-" * len(COST),
        ]
    ]


def _demonstrator(runs: Sequence[Run], backend: str, space: str) -> Episodes | None:
    for run in runs:
        if (
            run.setting.algorithm == JACOBIAN
            and is_plain(run.setting)
            and "nominal" in run.evaluations
        ):
            return run.evaluations["nominal"].where(backend=backend, space=space)
    return None


def _length_over(own: Episodes, other: Episodes | None) -> float | None:
    """Return the mean length over the other's, on the targets that both reach."""
    if other is None:
        return None
    targets = np.intersect1d(own.episode[own.success], other.episode[other.success])
    if not len(targets):
        return None
    means = [one.length[np.isin(one.episode, targets)].mean() for one in (own, other)]
    return float(means[0] / means[1])
