"""Small studies on disk, whose numbers are known by hand."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from training.study.report.beside_paper import Expected
from training.study.report.cells import Table
from training.study.report.contents import PAPER_TABLES
from training.study.report.records import Run

HEAD = ["backend", "space", "axis", "level", "episode", "success", "length", "distance"]
Row = tuple[str, str, str, float, str]
"""Engine, space, axis, level, and the outcomes of its episodes as in "110"."""


def write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *rows])


def write_run(
    study: Path,
    name: str,
    evaluations: Mapping[str, Sequence[Row]],
    curve: Sequence[tuple[int, float]] = (),
    /,
    **spec: object,
) -> Path:
    """A finished run; successes take 100 steps."""
    folder = study / name
    folder.mkdir(parents=True)
    usual = {
        "algorithm": "batd3",
        "preset": "tuned",
        "backend": "mujoco",
        "space": "anchor",
        "task": "reach",
        "seed": 0,
        "demonstrations": 10,
        "updates": 1000,
        "randomize": 0.0,
        "switches": {},
        "budget": "standard",
    }
    data = {
        "spec": {**usual, **spec},
        "minutes": 2.0,
        "updates": 1000,
        "environment_steps": 64000,
        "learner": {"critics": 2, "hidden": [16, 16]},
        "versions": {"numpy": "2.0"},
        "robot": "paper",
        "fingerprint": "f",
    }
    (folder / "run.json").write_text(json.dumps(data), "utf-8")
    for evaluation, rows in evaluations.items():
        episodes = [
            [*row[:4], i, x, 100 if x == "1" else 250, 0.01]
            for row in rows
            for i, x in enumerate(row[4])
        ]
        write_csv(folder / f"{evaluation}.csv", HEAD, episodes)
    if curve:
        write_csv(folder / "metrics.csv", ["update", "success_rate"], curve)
    return folder


def beside_paper(runs: Sequence[Run], expected: Expected | None) -> list[Table]:
    return [make(runs, expected) for make in PAPER_TABLES]


def nominal(outcomes: str, space: str = "anchor", backend: str = "mujoco") -> Row:
    return backend, space, "nominal", 0, outcomes


def find(table: Table, **wanted: object) -> dict[str, Any]:
    """The one row with these values, by head."""
    rows = [dict(zip(table.head, row, strict=True)) for row in table.rows]
    (row,) = [
        row
        for row in rows
        if all(row[name.replace("_", " ")] == value for name, value in wanted.items())
    ]
    return row


def shown(table: Table, *names: str) -> list[tuple[Any, ...]]:
    """Some columns of the rows that something was run for."""
    places = [table.head.index(name) for name in names]
    return [tuple(row[i] for i in places) for row in table.rows if row[table.head.index("seeds")]]


def small_study(folder: Path) -> Path:
    """Three seeds of BATD3 in Anchor Space, one of it in Spatter, and a demonstrator."""
    for seed, (own, other) in enumerate((("1111", "1110"), ("1110", "1110"), ("1000", "0001"))):
        rows = [nominal(own), nominal(other, backend="pybullet"), nominal("1100", "floating")]
        noise = [("mujoco", "anchor", "action_noise", 0.5, "1000")]
        curve = [(500, 0.1 * seed), (1000, 0.5)] + [(1500, 0.9)] * (seed == 0)
        write_run(
            folder,
            f"batd3-tuned_anchor_mujoco_d10_u1000_s{seed}",
            {"nominal": rows, "disturbances": noise},
            curve,
            seed=seed,
        )
    write_run(
        folder,
        "batd3-tuned_spatter_mujoco_d10_u1000_s0",
        {"nominal": [nominal("10", "spatter")]},
        space="spatter",
    )
    write_run(
        folder,
        "jacobian",
        {"nominal": [nominal("1111"), nominal("1111", "floating")]},
        algorithm="jacobian",
    )
    return folder
