"""Outputs complete or absent: written under a temporary name beside their place, then renamed. And JSON, read."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, replacing one of that name; missing folders on the way are made.

    Raises:
        CdcsrError: the place cannot be written to.
    """
    temporary = _beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.write_bytes(data)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _cannot_write(path, error) from None


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, as :func:`write_bytes` does."""
    write_bytes(path, text.encode())


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file, as :func:`write_bytes` does; NumPy arrays and scalars become lists and numbers.

    Raises:
        ValueError: a number is NaN or infinite, which JSON cannot say.
    """
    write_text(path, json.dumps(data, indent=2, allow_nan=False, default=_plain) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        CdcsrError: there is none.
    """
    try:
        data = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise CdcsrError(f"{path} cannot be read ({error}).") from None
    if not isinstance(data, dict):
        raise CdcsrError(f"{path} should hold a JSON object.")
    return data


def refuse_unwritable(path: Path) -> None:
    """Say before the work is done what would keep its outcome from being written to a file; nothing is made.

    Raises:
        CdcsrError: the place is a folder's, or lies under a file, or in a folder that may not be written to.
    """
    if path.is_dir():
        raise CdcsrError(f"{path} is a folder; give the name of a file.")
    above = next(folder for folder in path.absolute().parents if folder.exists())
    if not above.is_dir():
        raise CdcsrError(f"Cannot write {path}: {above} is a file.")
    if not os.access(above, os.W_OK):
        raise CdcsrError(f"Cannot write {path}: {above} may not be written to.")


@contextmanager
def new_folder(path: Path, force: bool) -> Iterator[Path]:
    """Build a folder as a whole: fill the one this yields, and it takes its place when the block ends.

    If the block fails, nothing is left of it, and a folder that was to be replaced is still there.

    Args:
        path: the folder's place; missing folders on the way are made.
        force: replace a folder that is there already.

    Raises:
        CdcsrError: the place is taken, cannot be replaced, or cannot be written to.
    """
    place = path.resolve()
    if place.exists():
        if not place.is_dir():
            raise CdcsrError(f"{path} is a file; give the name of a folder.")
        if not force:
            raise CdcsrError(
                f"{path} already exists; give another folder, or --force to replace it."
            )
        if Path.cwd().is_relative_to(place):
            raise CdcsrError(
                f"{path} holds the current folder and is not replaced; give another folder."
            )
    temporary = _beside(place)
    try:
        temporary.mkdir(parents=True)
    except OSError as error:
        raise _cannot_write(path, error) from None
    try:
        yield temporary
        _take_place(temporary, place)
    except BaseException as error:
        shutil.rmtree(temporary, ignore_errors=True)
        if isinstance(error, OSError):
            raise _cannot_write(path, error) from error
        raise


def _take_place(folder: Path, place: Path) -> None:
    """Rename `folder` to `place`; the one that was there goes only once the new one stands."""
    if not place.exists():
        folder.rename(place)
        return
    old = _beside(place)
    place.rename(old)
    try:
        folder.rename(place)
    except BaseException:
        old.rename(place)
        raise
    shutil.rmtree(old)


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON.")


def _cannot_write(path: Path, error: OSError) -> CdcsrError:
    return CdcsrError(f"Cannot write {path}: {error.strerror or error}.")
