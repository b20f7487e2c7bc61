"""Tables that go beyond the paper: variants, presets, tasks and plants."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import Literal

import numpy as np

from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import algorithm_title
from training.measure.plant_axes import AXES, Axis
from training.measure.statistics import Sweep, halving
from training.study.declare.learner_changes import GENERAL, OURS, PUT_BACK, RAISED
from training.study.report.cells import COST, TRAINED, Table, Value, cost, trained
from training.study.report.plant_sweeps import sweeps
from training.study.report.records import SPACES, Run, at_home, grouped, is_of_paper, is_usual
from training.study.report.table_parts import (
    RESULT,
    basis,
    engine_heads,
    engines_of,
    home_rows,
    in_engines,
)

SIDES: tuple[Literal["below", "above"], ...] = ("below", "above")
CHANGES_OF_ALL, _PUT_BACK, _RAISED = (
    [tuple(sorted(changes)) for changes in several] for several in (GENERAL, PUT_BACK, RAISED)
)


def own_ablation(runs: Sequence[Run]) -> Table:
    """Return the methods with single changed numbers, in the spaces where that was run."""
    chosen = variants(runs)
    rows = [row for space in SPACES for row in home_rows(chosen, space, ())]
    title = f"Variants of {algorithm_title(OURS)} and of the others"
    return Table("ours", title, basis(chosen), ("space", *TRAINED, *RESULT, *COST), rows)


def variants(runs: Iterable[Run]) -> list[Run]:
    """Return the runs with changed numbers in the paper's spaces, and those without beside them."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "tuned"]
    # What is for every method Table III has; what is put back has a table of its own.
    own = [run for run in own if run.setting.changes not in CHANGES_OF_ALL]
    own = [
        run for run in own if run.setting.algorithm == OURS or run.setting.changes not in _PUT_BACK
    ]
    varied = {(run.setting.algorithm, run.setting.space) for run in own if run.setting.changes}
    return [run for run in own if (run.setting.algorithm, run.setting.space) in varied]


def presets(runs: Sequence[Run]) -> Table:
    """Return the preset `tuned` with one number after another put back to `paper-reading`."""
    put_back = {
        run.setting for run in runs if is_usual(run.setting) and run.setting.changes in _PUT_BACK
    }
    put_back = {setting for setting in put_back if setting.algorithm != OURS}
    shown = put_back | {replace(setting, changes=()) for setting in put_back}
    chosen = [run for run in runs if run.setting in shown]
    rows = [row for space in SPACES for row in home_rows(chosen, space, ())]
    title = "The preset `tuned` with one number put back to the paper's"
    return Table("preset", title, basis(chosen), ("space", *TRAINED, *RESULT, *COST), rows)


def raised(runs: Sequence[Run]) -> Table:
    """Return the preset `paper-reading` with numbers of the preset `tuned`, few first."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "paper-reading"]
    spaces = {run.setting.space for run in own if run.setting.changes in _RAISED}
    chosen, rows = [], []
    for space, switches in product((space for space in SPACES if space in spaces), ((), *_RAISED)):
        some = [
            run
            for run in own
            if (run.setting.algorithm, run.setting.changes) == ("batd3", switches)
        ]
        chosen += at_home(some, space)
        rows += home_rows(at_home(some, space), space, ())
    title = "The paper's preset with numbers of the preset `tuned`"
    return Table("raised", title, basis(chosen), ("space", *TRAINED, *RESULT, *COST), rows)


def tasks(runs: Sequence[Run]) -> Table:
    """Return tasks and spaces beyond the paper, in every engine."""
    chosen = [run for run in runs if not is_of_paper(run.setting)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for setting, group in sorted(
        grouped(chosen).items(), key=lambda item: (item[0].task, item[0].space)
    ):
        rows.append(
            [
                setting.task,
                setting.space,
                *trained(setting),
                *in_engines(group, engines, setting.space),
                *cost(group),
            ]
        )
    head = ("task", "space", *TRAINED, *engine_heads(engines), *COST)
    return Table("tasks", "Tasks past the paper", basis(chosen), head, rows)


def halvings(runs: Sequence[Run]) -> Table:
    """Return where success halves as one number of the plant leaves the description."""
    chosen = [run for run in runs if "plants" in run.evaluations]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        for engine, space, (axis, description) in product(
            engines_of(group, "plants"), SPACES, AXES.items()
        ):
            found = sweeps(group, axis, engine, space)
            if found:
                low = min(float(one.levels[0]) for one in found.values())
                high = max(float(one.levels[-1]) for one in found.values())
                rows.append(
                    [
                        *trained(setting),
                        SPACES[space],
                        engine_title(engine),
                        description.title,
                        f"{low:g} to {high:g}",
                        *(_halving(list(found.values()), description, side) for side in SIDES),
                        *cost([run for run in group if run.name in found]),
                    ]
                )
    head = (*TRAINED, "space", "tested in", "plant", "swept", "halves below", "halves above", *COST)
    note = basis(chosen) + (
        " Means over seeds, interpolated between levels, by ratio where they are factors;"
        " intervals redraw seeds and episodes. `none`: success does not halve within the sweep;"
        " `-`: not swept on that side, or nothing succeeds on the plant trained on."
    )
    return Table("plants", "Levels of the plant at which success halves", note, head, rows)


def _halving(found: Sequence[Sweep], axis: Axis, side: Literal["above", "below"]) -> Value:
    """Find where success halves; between two factors, the middle is their geometric mean."""
    ratio = axis.unit == "factor" and all(one.levels.min() > 0 for one in found)
    scaled = [replace(one, levels=np.log(one.levels)) if ratio else one for one in found]
    crossing = halving(scaled, float(np.log(axis.nominal)) if ratio else axis.nominal, side)
    if crossing is None:
        return "-"
    level, low, high = (
        "none" if not np.isfinite(value) else f"{np.exp(value) if ratio else value:.3g}"
        for value in (crossing.level, crossing.low, crossing.high)
    )
    return f"{level} [{low}, {high}]"
