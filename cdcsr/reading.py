"""The one way to read a file: its kind and its size are checked before its content."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from pathlib import Path

from cdcsr.errors import CdcsrError

MOST_TEXT = 1 << 20
"""The largest description, in bytes. The largest that ships has 6 kB."""
MOST_RECORD = 1 << 24
"""The largest card or record, in bytes; 10,000 demonstrations make a card of 1 MB."""
MOST_TABLE = 1 << 28
"""The largest table, dataset or map, in bytes."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:=,+-]{0,199}")
"""The names that may become a part of a path: they lead to no other folder."""


def check_file(path: Path, most: int, what: str = "file") -> None:
    """Check that a path is an ordinary file of at most `most` bytes, without opening it.

    A pipe would block for ever, and a device has no end.

    Raises:
        CdcsrError: it is something else, or too large, or cannot be looked at.
    """
    try:
        found = path.stat()
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, a zero byte
        raise CdcsrError(f"Cannot read the {what} {path}: {_reason(error)}.") from None
    if not stat.S_ISREG(found.st_mode):
        raise CdcsrError(f"Cannot read the {what} {path}: it is no ordinary file.")
    if found.st_size > most:
        raise CdcsrError(
            f"Cannot read the {what} {path}: it has {found.st_size:,} bytes, and at most {most:,} "
            "are allowed."
        )


def exists(path: Path | str) -> bool:
    """Return whether something is at a path; nothing is at what can be no path.

    `Path.exists` raises an OSError for a name of more than 255 characters.
    """
    return os.path.exists(path)  # noqa: PTH110


def is_file(path: Path | str) -> bool:
    """Return whether an ordinary file is at a path; see :func:`exists`."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path | str) -> bool:
    """Return whether a folder is at a path; see :func:`exists`."""
    return os.path.isdir(path)  # noqa: PTH112


def read_bytes(path: Path, most: int, what: str = "file") -> bytes:
    """Return the content of an ordinary file of at most `most` bytes.

    Raises:
        CdcsrError: it is something else, or cannot be read.
    """
    check_file(path, most, what)
    try:
        with path.open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise CdcsrError(f"Cannot read the {what} {path}: {_reason(error)}.") from None


def read_text(path: Path, what: str = "file", most: int = MOST_TEXT) -> str:
    """Return the content of a text file in UTF-8, without its byte-order mark.

    Raises:
        CdcsrError: it is no such file, or cannot be read.
    """
    try:
        return read_bytes(path, most, what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CdcsrError(f"Cannot read the {what} {path}: it is not UTF-8 ({error}).") from None


def check_name(what: str, found: object) -> None:
    """Check that a name from a file can be the name of a file, and leads to no other folder.

    Raises:
        CdcsrError: it is no such name.
    """
    if not isinstance(found, str) or not _NAME.fullmatch(found):
        raise CdcsrError(
            f"{what} must be a name of letters, digits and _.:=,+- that begins with a letter or a "
            f"digit, at most 200 characters long; found {repr(found)[:100]}."
        )


def digest(data: bytes) -> str:
    """Return 16 hexadecimal digits of a file's content."""
    return hashlib.sha256(data).hexdigest()[:16]


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
