"""Read and write the results of the study.

Finished work is stored in one folder: a record of each run as a line of `runs.jsonl`, whose
learner's numbers are a line of `learners.jsonl` (many runs have the same), and five Parquet files:
`episodes` (a row an episode of an evaluation), `metrics` (a row a point of a learning curve),
`following` (a row a sample of target following), `searches` (a row a target of `cdcsr search`,
whose options are in `searches.jsonl`) and `sweeps` (a row an episode of `cdcsr sweep --csv`). Work
in progress is a folder for each run, with `run.json`, `metrics.csv` and a CSV file for each
evaluation; :func:`pack` moves it over.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import finish_together, read_json, write_together
from cdcsr.reading import MOST_TABLE, is_file, is_folder, read_bytes
from cdcsr.tables import read_csv_rows
from training.study.lines import RECORDS, read_lines, read_records, record_files
from training.study.parquet import DECIMALS, SUMS, Columns, read_table, sums, table_bytes

Convert = Callable[[str], object]
_Table = Mapping[str, Sequence[object] | NDArray[np.generic]]
Files = dict[str, bytes | None]
"""Contents of files by name; None for a file that is not there."""
_KINDS = "*.parquet", "*.jsonl"

RECORD, SHIPPED = "run.json", "shipped.jsonl"
METRICS, FOLLOW = "metrics", "follow"
EPISODE_KINDS: dict[str, Convert] = {
    "backend": str,
    "space": str,
    "axis": str,
    "level": float,
    "episode": int,
    "success": float,
    "length": float,
    "distance": float,
}
FOLLOW_KINDS: dict[str, Convert] = {
    "backend": str,
    "motion": str,
    "episode": int,
    "step": int,
    "tip_error": float,
    "base_position_error": float,
    "base_attitude_error": float,
}


@dataclass
class StoredRun:
    """The results of one run."""

    record: dict[str, object]
    metrics: Columns = field(default_factory=dict)
    """Points of the learning curve; an empty cell is NaN. Empty for what learns no updates."""
    evaluations: dict[str, Columns] = field(default_factory=dict)
    """Episodes of each evaluation, with the columns :data:`EPISODE_KINDS`."""
    follow: Columns | None = None
    """Samples of target following, with the columns :data:`FOLLOW_KINDS`."""
    source: str = ""
    """The file or folder it was read from, for messages."""

    def episodes(self, evaluation: str) -> int:
        """Return how many episodes each cell of an evaluation has; 0 if there is no such one."""
        columns = self.follow if evaluation == FOLLOW else self.evaluations.get(evaluation)
        return int(columns["episode"].max()) + 1 if columns and len(columns["episode"]) else 0


def read_results(folder: Path) -> dict[str, StoredRun]:
    """Return all finished runs by name, from a store or from a folder of work in progress.

    Raises:
        CdcsrError: there is no such folder, or a file in it is damaged.
    """
    if not is_folder(folder):
        raise CdcsrError(
            f"There is no folder {folder}; give the one that holds the study's runs with --results."
        )
    return read_store(folder) or {
        path.parent.name: _read_run(path.parent) for path in sorted(folder.glob("*/run.json"))
    }


def read_store(folder: Path) -> dict[str, StoredRun]:
    """Return all finished runs of a store by name; a folder that is none yet has no runs.

    Raises:
        CdcsrError: a file in it is damaged.
    """
    finish_together(folder)
    path = folder / RECORDS
    if not is_file(path):
        return {}
    records = read_records(folder)
    runs = {name: StoredRun(record, source=str(path)) for name, record in records.items()}
    wanted = ("run", "evaluation", *EPISODE_KINDS)
    for key, part in _split(folder / "episodes.parquet", wanted):
        _of_run(runs, key[0], folder).evaluations[key[1]] = part
    for key, part in _split(folder / "metrics.parquet", ("run", "update")):
        _of_run(runs, key[0], folder).metrics = part
    for key, part in _split(folder / "following.parquet", ("run", *FOLLOW_KINDS)):
        _of_run(runs, key[0], folder).follow = part
    return runs


def pack(work: Path, store: Path) -> int:
    """Move the finished runs of a working folder into a store; return how many there were.

    Evaluations of a policy that the store knows are added to those it has. Results of another
    policy replace all that the store has of the run. Folders of `cdcsr search` and CSV files of
    `cdcsr sweep` in the working folder are packed by their names. The working folder stays.

    Raises:
        CdcsrError: a folder is missing, or a file is damaged or cannot be written.
    """
    new = read_results(work)
    runs = read_store(store)
    for name, run in new.items():
        old = runs.get(name)
        if old is not None and old.record.get("policy") == run.record.get("policy"):
            run.evaluations = {**old.evaluations, **run.evaluations}
            run.follow = old.follow if run.follow is None else run.follow
        runs[name] = run
    files = _store(runs) | _pack_searches(work, store)
    sweeps = {path.stem: path for path in work.glob("*.csv")}
    files["sweeps.parquet"] = _pack_named(store / "sweeps.parquet", sweeps)
    write_files(store, files)
    return len(new)


def _pack_searches(work: Path, store: Path) -> Files:
    found = {path.parent.name: path for path in work.glob("*/search.json")}
    path = store / "searches.jsonl"
    options = {str(record["name"]): record for record in read_lines(path)} if path.is_file() else {}
    options |= {name: {"name": name, **read_json(one)} for name, one in found.items()}
    lines = "".join(json.dumps(options[name]) + "\n" for name in sorted(options))
    tables = {name: one.with_name("targets.csv") for name, one in found.items()}
    packed = _pack_named(store / "searches.parquet", tables)
    return {path.name: lines.encode() or None, "searches.parquet": packed}


def _pack_named(path: Path, files: Mapping[str, Path]) -> bytes | None:
    """Return a Parquet file whose column `name` has the names of CSV files, with these added."""
    known = read_table(path)
    names = known.pop("name", np.array([], dtype=np.str_))
    parts = {
        str(name): {key: values[names == name] for key, values in known.items()}
        for name in np.unique(names)
    }
    texts: dict[str, Convert] = {"backend": str, "space": str, "axis": str}
    for name, file in files.items():
        table = read_csv(file, {}, others=float, texts=texts)
        parts[name] = {
            key: np.round(values.astype(float), DECIMALS) if values.dtype.kind == "f" else values
            for key, values in table.items()
        }
    return table_bytes([_of(name, parts[name], "name") for name in sorted(parts)])


def write_store(folder: Path, runs: Mapping[str, StoredRun]) -> None:
    """Write runs as a store, in the order of their names.

    Raises:
        CdcsrError: a file cannot be written.
    """
    write_files(folder, _store(runs))


def write_files(folder: Path, files: Files) -> None:
    """Write the files of a store with their checksums; delete those that have become empty."""
    there = {name: data for name, data in files.items() if data is not None}
    # Other files of the store, such as those that this command does not make, stay.
    others = {path.name: path for pattern in _KINDS for path in folder.glob(pattern)}
    kept = {
        name: read_bytes(path, MOST_TABLE) for name, path in others.items() if name not in files
    }
    gone = {name: None for name, data in files.items() if data is None and name in others}
    write_together(folder, {**there, **gone, SUMS: sums({**kept, **there})})


def _store(runs: Mapping[str, StoredRun]) -> Files:
    """Return the files of a store by name."""
    files: Files = {}
    names = sorted(runs)
    episodes = [
        {"run": [name] * len(columns["episode"]), "evaluation": [one] * len(columns["episode"])}
        | columns
        for name in names
        for one, columns in sorted(runs[name].evaluations.items())
    ]
    for file, parts in (
        ("episodes", episodes),
        (METRICS, _with_all_columns([_of(n, runs[n].metrics) for n in names if runs[n].metrics])),
        (
            "following",
            [_of(name, follow) for name in names if (follow := runs[name].follow) is not None],
        ),
    ):
        files[f"{file}.parquet"] = table_bytes(parts)
    return files | record_files({name: runs[name].record for name in names})


def _with_all_columns(parts: Sequence[_Table]) -> list[_Table]:
    """Return tables with the columns of all of them; older runs lack some, whose cells are NaN."""
    columns = {name: None for part in parts for name in part}
    return [
        {name: part.get(name, [np.nan] * len(part["run"])) for name in columns} for part in parts
    ]


def _of(name: str, columns: Columns, key: str = "run") -> _Table:
    return {key: [name] * len(next(iter(columns.values()))), **columns}


def _of_run(runs: Mapping[str, StoredRun], name: str, folder: Path) -> StoredRun:
    if name not in runs:
        raise CdcsrError(f"{folder / RECORDS} lacks the run {name}; restore it from git.")
    return runs[name]


def _split(path: Path, wanted: Sequence[str]) -> Iterable[tuple[tuple[str, ...], Columns]]:
    """Yield the rows of each run, and of each evaluation if there are several, with their names."""
    columns = read_table(path, wanted)
    keys = [columns.pop(name) for name in ("run", "evaluation") if name in columns]
    if not keys or not len(keys[0]):
        return
    changed = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    bounds = [0, *(np.flatnonzero(changed) + 1).tolist(), len(keys[0])]
    for start, stop in pairwise(bounds):
        names = tuple(str(key[start]) for key in keys)
        yield names, {name: values[start:stop] for name, values in columns.items()}


def _read_run(folder: Path) -> StoredRun:
    """Return a run from its working folder."""
    run = StoredRun(read_json(folder / RECORD), source=str(folder / RECORD))
    for path in sorted(folder.glob("*.csv")):
        if path.stem == METRICS:
            run.metrics = read_csv(path, {}, others=float)
        elif path.stem == FOLLOW:
            run.follow = read_csv(path, FOLLOW_KINDS)
        else:
            run.evaluations[path.stem] = read_episodes(path)
    return run


def read_episodes(path: Path) -> Columns:
    """Return the episodes in a CSV file of an evaluation, with the columns :data:`EPISODE_KINDS`.

    Raises:
        CdcsrError: a column is missing, a cell is not what it should be, or episodes are missing.
    """
    columns = read_csv(path, EPISODE_KINDS)
    if (
        not np.isin(columns["success"], (0, 1)).all()
        or not (columns["length"].astype(float) >= 0).all()
    ):
        raise CdcsrError(
            f"{path} has a success that is not 0 or 1, or a length that is none; delete it and "
            "make it again."
        )
    cells: dict[tuple[object, ...], list[int]] = {}
    names = ("backend", "space", "axis", "level", "episode")
    for *cell, episode in zip(*(columns[name].tolist() for name in names), strict=True):
        cells.setdefault(tuple(cell), []).append(episode)
    most = max(map(len, cells.values()), default=0)
    for cell, episodes in cells.items():
        if sorted(episodes) != list(range(most)):
            raise CdcsrError(
                f"{path} should have episodes 0 to {most - 1} of {', '.join(map(str, cell))}; "
                "delete it and make it again."
            )
    return columns


def read_csv(
    path: Path,
    kinds: Mapping[str, Convert],
    others: Convert | None = None,
    texts: Mapping[str, Convert] | None = None,
) -> Columns:
    """Return the columns of a CSV file.

    Args:
        path: the file.
        kinds: how the cells of each wanted column are converted.
        others: how those of all other columns are; None leaves them out.
        texts: the same for columns that may be missing.

    Raises:
        CdcsrError: a column is missing, or a cell cannot be converted.
    """
    try:
        head, rows = read_csv_rows(path)
    except ValueError as error:
        raise CdcsrError(f"{path} is damaged ({error}); delete it and make it again.") from None
    if missing := [name for name in kinds if name not in head]:
        raise CdcsrError(
            f"{path} has no column {', '.join(missing)} (found: {', '.join(head) or 'nothing'}); "
            "delete it and make it again."
        )
    known = {name: kind for name, kind in (texts or {}).items() if name in head}
    all_kinds = {**({} if others is None else dict.fromkeys(head, others)), **known, **kinds}
    try:
        return {
            name: np.array(
                [kind(row[head.index(name)] or "nan") for row in rows],
                dtype=np.str_ if kind is str else None,
            )
            for name, kind in all_kinds.items()
        }
    except (ValueError, IndexError) as error:
        raise CdcsrError(
            f"{path} has a row that does not fit its columns ({error}); delete it and "
            "make it again."
        ) from None
