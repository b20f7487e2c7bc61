"""Tables of what `cdcsr search` and `cdcsr sweep` measured of shipped policies."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cdcsr.simulation.engines import engine_title
from training.measure.statistics import pooled
from training.study.parquet import read_table
from training.study.report.cells import Table, Value

SEARCH_COLUMNS = ("episode", "reached", "length", "best_reached", "best_length")
SWEEP_COLUMNS = ("backend", "space", "axis", "level", "success")


def searches(results: Path) -> Table:
    """Build the table of what a search for better commands gains."""
    data = read_table(results / "searches.parquet", ("name", *SEARCH_COLUMNS))
    rows: list[list[Value]] = []
    for name in np.unique(data["name"]) if data else ():
        own = {one: data[one][data["name"] == name].astype(float) for one in SEARCH_COLUMNS}
        rows.append([str(name), *(f"{own[one].mean():.4g}" for one in SEARCH_COLUMNS[1:])])
    head = ("search", "κ before", "length mean", "κ after", "best length mean")
    note = "Means over 100 held-out targets; a failure counts in full."
    return Table("searches", "Searches for better commands", note, head, rows)


def shipped(results: Path) -> Table:
    """Build the table of shipped policies with the engines' stock settings."""
    data = read_table(results / "sweeps.parquet", ("name", *SWEEP_COLUMNS))
    rows: list[list[Value]] = []
    if data:
        chosen = data["axis"] == "engine_defaults"
        for name in np.unique(data["name"]):
            for engine in np.unique(data["backend"]):
                own = chosen & (data["name"] == name) & (data["backend"] == engine)
                levels = [own & (data["level"] == level) for level in (0, 1)]
                if all(one.any() for one in levels):
                    values = [pooled([data["success"][one] == 1]) for one in levels]
                    rows.append([str(name), engine_title(str(engine)), *values])
    head = ("policy", "tested in", "κ agreed", "κ stock")
    note = "100 held-out targets in Spatter; intervals over episodes."
    return Table("shipped", "Shipped policies with stock settings", note, head, rows)
