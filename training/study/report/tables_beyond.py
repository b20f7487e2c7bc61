"""Tables that go beyond the paper: variants, presets, tasks, plants and shipped policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import algorithm_title
from training.measure.plant_axes import AXES, Axis
from training.measure.statistics import Sweep, halving, iqm, over_seeds
from training.study.declare.learner_changes import GENERAL, OURS, PUT_BACK, RAISED
from training.study.parquet import read_table
from training.study.report.cells import COST, TRAINED, Table, Value, cost, measure, trained
from training.study.report.plant_sweeps import sweeps
from training.study.report.records import (
    SPACES,
    Run,
    at_home,
    grouped,
    is_plain,
    is_usual,
)
from training.study.report.table_parts import (
    RESULT,
    basis,
    engines_of,
    home_rows,
    home_table,
)

SIDES: tuple[Literal["below", "above"], ...] = ("below", "above")
CHANGES_OF_ALL, _PUT_BACK, _RAISED = (
    [tuple(sorted(changes)) for changes in several] for several in (GENERAL, PUT_BACK, RAISED)
)
_SEARCHED = ("episode", "reached", "length", "best_reached", "best_length")
"""Columns of what `cdcsr search` stored."""


def aggregate(runs: Sequence[Run]) -> Table:
    """Return success in the space and engine of training, over seeds and all spaces.

    Spaces are the tasks of the stratified bootstrap (Agarwal et al. 2021): seeds are redrawn in
    each space by itself. Only methods with at least two seeds in all spaces are shown.
    """
    chosen = [run for run in runs if is_plain(run.setting)]
    used: list[Run] = []
    rows: list[tuple[float, list[Value]]] = []
    for setting, group in grouped(chosen, "space").items():
        cells = {
            (run.setting.space, run.seed): measure([run], "nominal", space=run.setting.space)
            for run in group
        }
        scores: dict[int | None, list[float]] = {}
        for seed in {run.seed: None for run in group}:
            found = [cell for space in SPACES if (cell := cells.get((space, seed)))]
            if len(found) == len(SPACES):
                scores[seed] = [cell.success.value for cell in found]
        if len(scores) > 1:
            own = [run for run in group if run.seed in scores]
            used += own
            table = np.array([*scores.values()])
            middle = over_seeds(table, iqm)
            values = [over_seeds(table), middle, len(scores), *cost(own)[1:]]
            rows.append((middle.value, [*trained(setting), *values]))
    note = basis(used) + (
        " The interquartile mean leaves out the best and the worst quarter of a method's runs."
        " Brackets are 95 % percentile intervals of a bootstrap that redraws seeds in each space by"
        " itself; of three seeds they are about the range."
    )
    best_first = [row for _, row in sorted(rows, key=lambda row: -row[0])]
    head = (*TRAINED, "κ", "IQM of κ", *COST)
    return Table("aggregate", "The three spaces together", note, head, best_first)


def own_ablation(runs: Sequence[Run]) -> Table:
    """Return the methods with single changed numbers, in the spaces where that was run."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "tuned"]
    # Table III has the changes that are for every method, and what is put back has its own table.
    own = [run for run in own if run.setting.changes not in CHANGES_OF_ALL]
    own = [
        run for run in own if run.setting.algorithm == OURS or run.setting.changes not in _PUT_BACK
    ]
    varied = {(run.setting.algorithm, run.setting.space) for run in own if run.setting.changes}
    chosen = [run for run in own if (run.setting.algorithm, run.setting.space) in varied]
    return home_table("ours", f"Variants of {algorithm_title(OURS)} and of the others", chosen)


def presets(runs: Sequence[Run]) -> Table:
    """Return the preset `tuned` with one number after another put back to `paper-reading`."""
    put_back = {
        run.setting for run in runs if is_usual(run.setting) and run.setting.changes in _PUT_BACK
    }
    put_back = {setting for setting in put_back if setting.algorithm != OURS}
    shown = put_back | {replace(setting, changes=()) for setting in put_back}
    chosen = [run for run in runs if run.setting in shown]
    return home_table(
        "preset", "The preset `tuned` with one number put back to the paper's", chosen
    )


def raised(runs: Sequence[Run]) -> Table:
    """Return the preset `paper-reading` with numbers of the preset `tuned`, few first."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "paper-reading"]
    spaces = {run.setting.space for run in own if run.setting.changes in _RAISED}
    chosen, rows = [], []
    for space, switches in product((space for space in SPACES if space in spaces), ((), *_RAISED)):
        wanted = ("batd3", switches)
        some = [run for run in own if (run.setting.algorithm, run.setting.changes) == wanted]
        chosen += at_home(some, space)
        rows += home_rows(at_home(some, space), space)
    title = "The paper's preset with numbers of the preset `tuned`"
    return Table("raised", title, basis(chosen), ("space", *TRAINED, *RESULT, *COST), rows)


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
                several = list(found.values())
                low = min(float(one.levels[0]) for one in several)
                high = max(float(one.levels[-1]) for one in several)
                plant = [SPACES[space], engine_title(engine), description.title]
                levels = [_halving(several, description, side) for side in SIDES]
                rest = cost([run for run in group if run.name in found])
                rows.append([*trained(setting), *plant, f"{low:g} to {high:g}", *levels, *rest])
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


def searches(results: Path) -> Table:
    """Build the table of what a search for better commands gains."""
    data = read_table(results / "searches.parquet", ("name", *_SEARCHED))
    rows: list[list[Value]] = []
    for name in np.unique(data["name"]) if data else ():
        own = {one: data[one][data["name"] == name].astype(float) for one in _SEARCHED}
        rows.append([str(name), *(f"{own[one].mean():.4g}" for one in _SEARCHED[1:])])
    head = ("search", "κ before", "length mean", "κ after", "best length mean")
    note = "Means over 100 held-out targets; a failure counts in full."
    return Table("searches", "Searches for better commands", note, head, rows)
