"""Tables: in Markdown, and as CSV files that tell when they are damaged."""

from __future__ import annotations

import csv
import io
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

from cdcsr.reading import MOST_TABLE, read_text

CHECK = "crc32"
"""The last column of a CSV file: in every row the checksum of the text without this column."""


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table whose columns line up, without a line break at its end.

    Args:
        head: the columns' names.
        rows: as many cells each as `head`.
    """
    lines = [head, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(f"{cell:<{w}}" for cell, w in zip(line, widths, strict=True)) + " |"
        for line in lines
    )


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV, with the column :data:`CHECK` at its end."""
    lines = [[str(cell) for cell in row] for row in (head, *rows)]
    check = _checksum(lines)
    return _text([[*lines[0], CHECK], *([*line, check] for line in lines[1:])])


def read_csv_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of a CSV file, without the column :data:`CHECK`.

    A file of an older version has no such column, and damage of it is not seen.

    Raises:
        CdcsrError: it is no ordinary text file, or too large.
        ValueError: it is no table with rows, or has not the content that was written.
    """
    try:
        lines = list(csv.reader(io.StringIO(read_text(path, "table", MOST_TABLE), newline="")))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    if len(lines) < 2:
        raise ValueError("it has no rows")
    for number, line in enumerate(lines, 1):
        if len(line) != len(lines[0]):
            raise ValueError(f"line {number} has {len(line)} cells, not {len(lines[0])}")
    last, rest = [line[-1:] for line in lines], [line[:-1] for line in lines]
    is_checked = all(cells == [_checksum(rest)] for cells in last[1:])
    if (last[0] == [CHECK]) != is_checked:
        raise ValueError("its content has not the checksum that it had when it was written")
    head, *rows = rest if is_checked else lines
    if len(set(head)) < len(head):
        raise ValueError("two columns have the same name")
    return head, rows


def _checksum(lines: Sequence[Sequence[str]]) -> str:
    return str(zlib.crc32(_text(lines).encode()))


def _text(lines: Iterable[Sequence[str]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()
