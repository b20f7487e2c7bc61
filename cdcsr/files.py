"""The one way to write a file, the check that it can be written, and the reading of JSON.

Files are complete or absent: they are written under a temporary name beside their place and then
renamed. A process that is killed leaves at most a hidden file, which the next process that writes
into the folder deletes.
"""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError, cannot_write
from cdcsr.leftovers import check_depth, make_folder, remove, sweep, temporary_beside
from cdcsr.reading import MOST_RECORD, digest, read_text

JsonObject = dict[str, Any]
"""An object read from JSON; whoever reads it knows its values."""
SEAL = "content_digest"
"""The key of a record's digest."""
_TOGETHER, _GONE = ".cdcsr-together", ".gone"
"""The hidden folder of files that belong together, and the end of names that are to be deleted."""


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, replacing one of that name; make missing folders on the way.

    What a link points to is written, a file keeps its mode, and a device or a pipe is written into.

    Raises:
        CdcsrError: the file cannot be written.
    """
    try:
        found = _look(path)
        if found is not None and (_is_output(found) or not stat.S_ISREG(found.st_mode)):
            sys.stdout.flush()  # what was printed before comes first
            target = os.dup(1) if _is_output(found) else os.open(path, os.O_WRONLY)
            with os.fdopen(target, "wb") as file:
                file.write(data)
            return
    except OSError as error:
        raise cannot_write(path, error) from None
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_together(folder: Path, files: Mapping[str, bytes | None]) -> None:
    """Write files of one folder that belong together: all or none, also if the process is killed.

    They are written into a hidden folder first. Its renaming decides; after that, whoever calls
    :func:`finish_together` moves what a killed process has left there.

    Args:
        folder: where they belong.
        files: their contents by name; None deletes a file.

    Raises:
        CdcsrError: a file cannot be written.
    """
    finish_together(folder)
    temporary = temporary_beside(folder / _TOGETHER)
    try:
        make_folder(folder)
        sweep(folder)
        temporary.mkdir()
        for name, data in files.items():
            place = folder / name
            if place.exists():
                _refuse_protected(place)
            path = temporary / (name if data is not None else name + _GONE)
            path.write_bytes(data or b"")
            if place.exists():
                path.chmod(stat.S_IMODE(place.stat().st_mode))
        temporary.rename(folder / _TOGETHER)
    except OSError as error:
        raise cannot_write(folder, error) from None
    finally:
        remove(temporary)
    finish_together(folder)


def finish_together(folder: Path) -> None:
    """Move the files to their places that a killed :func:`write_together` had decided to write.

    Raises:
        CdcsrError: one cannot be moved.
    """
    try:
        for path in [*(folder / _TOGETHER).glob("*")]:
            place = Path(os.path.realpath(folder / path.name.removesuffix(_GONE)))
            with suppress(FileNotFoundError):  # another process moves them too
                if path.name.endswith(_GONE):
                    place.unlink(missing_ok=True)
                    path.unlink()
                else:
                    path.replace(place)
        with suppress(FileNotFoundError):
            (folder / _TOGETHER).rmdir()
    except OSError as error:
        raise cannot_write(folder, error) from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name; the file under it takes the place of `path` when the block ends.

    If the block fails, what was at `path` is still there, and nothing else is left.

    Raises:
        CdcsrError: the file cannot be written.
    """
    temporary: Path | None = None
    try:
        place = Path(os.path.realpath(path))
        temporary = temporary_beside(place)
        make_folder(place.parent)
        sweep(place.parent)
        found = _look(place)
        if found is not None:
            _refuse_protected(place)
        yield temporary
        if found is not None:
            temporary.chmod(stat.S_IMODE(found.st_mode))
        temporary.replace(place)
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, as :func:`write_bytes` does."""
    write_bytes(path, text.encode())


def write_json(path: Path, data: object) -> None:
    """Write a JSON file, as :func:`write_bytes` does; NumPy arrays become lists, and their scalars
    numbers.

    Raises:
        ValueError: a number is NaN or infinite, which JSON cannot express.
    """
    write_text(path, json.dumps(data, indent=2, allow_nan=False, default=_plain) + "\n")


def read_json(path: Path) -> JsonObject:
    """Return the object in a JSON file, without its digest if it has one.

    Raises:
        CdcsrError: the file cannot be read, holds no JSON object, or has not the content that its
            digest was made of.
    """
    try:
        data = json.loads(read_text(path, most=MOST_RECORD))
    except (ValueError, RecursionError) as error:
        raise CdcsrError(f"{path} cannot be read ({error}).") from None
    if not isinstance(data, dict):
        raise CdcsrError(f"{path} cannot be read (it should hold a JSON object).")
    if not _is_whole(data):
        raise CdcsrError(
            f"{path} is damaged: its content has not the digest that it had when it was written; "
            "copy it again, or make it again."
        )
    return {key: value for key, value in data.items() if key != SEAL}


def sealed(data: Mapping[str, object]) -> dict[str, object]:
    """Return data of a record with a digest of it, which :func:`read_json` checks and removes."""
    plain = json.loads(json.dumps(data, allow_nan=False, default=_plain))
    return {**plain, SEAL: _content_digest(plain)}


def _is_whole(data: JsonObject) -> bool:
    """Return whether data have the digest in them; those of older versions have none."""

    def is_digest(key: str) -> bool:
        return data[key] == _content_digest({k: v for k, v in data.items() if k != key})

    if SEAL in data:
        return is_digest(SEAL)
    # A digest under another key is one whose key was damaged.
    texts = (key for key, value in data.items() if isinstance(value, str) and len(value) == 16)
    return not any(map(is_digest, texts))


def _content_digest(plain: Mapping[str, object]) -> str:
    return digest(json.dumps(plain, sort_keys=True).encode())


@cache
def note(message: str) -> None:
    """Tell the user what is no error, in a line apart from results, once in a process."""
    print(f"cdcsr: note: {message}", file=sys.stderr)


def refuse_unwritable(path: Path) -> None:
    """Check before long work whether a file can be written at its end; nothing is made.

    Raises:
        CdcsrError: the path is a folder, lies under a file, is too long, or is protected.
    """
    try:
        found = _look(path)
        if found is not None:
            if stat.S_ISDIR(found.st_mode):
                raise CdcsrError(f"{path} is a folder; give the name of a file.")
            _refuse_protected(path)
            if not stat.S_ISREG(found.st_mode):  # a device or a pipe, which stays what it is
                return
        place = Path(os.path.realpath(path))
        above = next(folder for folder in place.parents if folder.exists())
    except OSError as error:
        raise cannot_write(path, error) from None
    if not above.is_dir():
        raise CdcsrError(f"Cannot write {path}: {above} is a file.")
    if not os.access(above, os.W_OK):
        raise CdcsrError(f"Cannot write {path}: {above} may not be written to.")


def refuse_taken(path: Path, force: bool) -> None:
    """Check before long work that a new file can be written, as :func:`refuse_unwritable` does.

    Args:
        path: the file.
        force: a file that is there already may be replaced.

    Raises:
        CdcsrError: it cannot be written, or is there already.
    """
    refuse_unwritable(path)
    if path.is_file() and not force:
        raise CdcsrError(f"{path} already exists; give another name, or --force to replace it.")


def _look(path: Path) -> os.stat_result | None:
    """Return what the system knows of what is at a path, links followed; None if nothing is there.

    Raises:
        OSError: a name is too long, links run in a circle, or the folder may not be searched.
    """
    check_depth(path)
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _refuse_protected(path: Path) -> None:
    """Check that what is at `path` may be written to, though its folder may be."""
    if not os.access(path, os.W_OK):
        raise CdcsrError(f"Cannot write {path}: it is protected against writing.")


def _is_output(found: os.stat_result) -> bool:
    """Return whether a file is this process's standard output, as /dev/stdout is."""
    try:
        return os.path.samestat(found, os.fstat(1))
    except OSError:  # it is closed
        return False


def _plain(value: object) -> object:
    """Return an array or a scalar of NumPy or torch as plain data."""
    tolist = getattr(value, "tolist", None)
    if callable(tolist):
        return tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON.")
