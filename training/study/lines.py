"""Read and write the records of runs as lines of JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path

from cdcsr.errors import CdcsrError
from training.study.parquet import is_summed, read_summed

RECORDS, LEARNERS = "runs.jsonl", "learners.jsonl"


def read_lines(path: Path) -> list[dict[str, object]]:
    """Return the JSON objects with a name in the lines of a file.

    Raises:
        CdcsrError: the file is damaged.
    """
    try:
        records = [json.loads(line) for line in read_summed(path).decode().splitlines()]
    except (ValueError, RecursionError) as error:
        raise CdcsrError(f"{path} is damaged ({error}); restore it from git.") from None
    if not all(isinstance(record, dict) and "name" in record for record in records):
        raise CdcsrError(f"{path} is damaged (a line has no name); restore it from git.")
    return records


def read_records(folder: Path) -> dict[str, dict[str, object]]:
    """Return the record of each run of a store by the run's name.

    Raises:
        CdcsrError: a file is damaged, or lacks the numbers of a learner.
    """
    path = folder / LEARNERS
    # Records of older versions hold the numbers themselves.
    learners = _by_name(read_lines(path)) if path.is_file() or is_summed(path) else {}
    records = _by_name(read_lines(folder / RECORDS))
    for record in records.values():
        digest = record.get("learner")
        if isinstance(digest, str):
            if digest not in learners:
                raise CdcsrError(f"{path} lacks the learner {digest}; restore it from git.")
            record["learner"] = dict(learners[digest])
    return records


def record_files(records: Mapping[str, Mapping[str, object]]) -> dict[str, bytes | None]:
    """Return the files of records by name; equal numbers of learners stand in them once."""
    learners: dict[str, dict[str, object]] = {}
    lines: list[dict[str, object]] = []
    for name, record in records.items():
        line = {"name": name, **record}
        numbers = record.get("learner")
        if isinstance(numbers, dict) and numbers:
            digest = sha256(json.dumps(numbers).encode()).hexdigest()[:8]
            learners[digest] = {"name": digest, **numbers}
            line["learner"] = digest
        lines.append(line)
    return {
        RECORDS: _json_lines(lines),
        LEARNERS: _json_lines(learners[name] for name in sorted(learners)),
    }


def _json_lines(records: Iterable[Mapping[str, object]]) -> bytes | None:
    return "".join(json.dumps(record) + "\n" for record in records).encode() or None


def _by_name(records: Iterable[dict[str, object]]) -> dict[str, dict[str, object]]:
    return {str(record.pop("name")): record for record in records}
