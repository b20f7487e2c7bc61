"""Sweeps of the plant: one of its numbers at a time leaves the description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cdcsr.errors import CdcsrError, unknown_choice
from training.measure.plant_axes import AXES
from training.measure.statistics import Sweep
from training.study.report.records import Run


def sweeps(runs: Sequence[Run], axis: str, engine: str, space: str) -> dict[str, Sweep]:
    """Return the sweeps of some seeds along one axis, by the names of their runs.

    If the evaluation lacks the nominal level, it comes from the nominal evaluation. A level at
    which the simulation diverged has no rows and is no level of the sweep.

    Args:
        runs: any.
        axis: one of :data:`training.measure.plant_axes.AXES`.
        engine: where they were tested.
        space: the space they were tested in.

    Raises:
        CdcsrError: the levels of a run have different episodes.
    """
    found: dict[str, Sweep] = {}
    for run in runs:
        if "plants" not in run.evaluations:
            continue
        plants = run.evaluations["plants"].where(backend=engine, space=space, axis=axis)
        if not len(plants):
            continue
        columns = {float(level): plants.where(level=level) for level in np.unique(plants.level)}
        if AXES[axis].nominal not in columns and "nominal" in run.evaluations:
            columns[AXES[axis].nominal] = run.evaluations["nominal"].where(
                backend=engine, space=space
            )
        ordered = [columns[level] for level in sorted(columns)]
        if any(not np.array_equal(one.episode, ordered[0].episode) for one in ordered):
            raise CdcsrError(
                f"Run {run.name}: levels of {axis} have different episodes; evaluate it again."
            )
        outcomes = np.stack([one.success for one in ordered], axis=1)
        found[run.name] = Sweep(np.array(sorted(columns)), outcomes)
    return found


def check_axes(runs: Sequence[Run]) -> None:
    """Refuse a sweep whose nominal level is not known.

    Raises:
        CdcsrError: an axis is none of :data:`training.measure.plant_axes.AXES`.
    """
    for run in runs:
        if "plants" in run.evaluations:
            for name in np.unique(run.evaluations["plants"].axis):
                if name not in (*AXES, "nominal"):
                    raise CdcsrError(
                        f"Run {run.name}: " + unknown_choice("axis of the plant", str(name), AXES)
                    )
