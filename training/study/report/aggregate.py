"""The paper's three spaces together, a row for each method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from training.measure.statistics import iqm, over_seeds
from training.study.report.cells import COST, TRAINED, Table, Value, cost, measure, trained
from training.study.report.records import SPACES, Run, grouped, is_plain
from training.study.report.table_parts import basis


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
        seeds = [
            seed
            for seed in {run.seed: None for run in group}
            if all(cells.get((s, seed)) for s in SPACES)
        ]
        if len(seeds) > 1:
            scores = np.array(
                [
                    [cell.success.value for space in SPACES if (cell := cells[space, seed])]
                    for seed in seeds
                ]
            )
            own = [run for run in group if run.seed in seeds]
            used += own
            middle = over_seeds(scores, iqm)
            rows.append(
                (
                    middle.value,
                    [*trained(setting), over_seeds(scores), middle, len(seeds), *cost(own)[1:]],
                )
            )
    note = basis(used) + (
        " The interquartile mean leaves out the best and the worst quarter of a method's runs."
        " Brackets are 95 % percentile intervals of a bootstrap that redraws seeds in each space by"
        " itself; of three seeds they are about the range."
    )
    best_first = [row for _, row in sorted(rows, key=lambda row: -row[0])]
    return Table(
        "aggregate",
        "The three spaces together",
        note,
        (*TRAINED, "κ", "IQM of κ", *COST),
        best_first,
    )
