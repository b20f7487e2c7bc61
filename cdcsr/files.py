"""The one way to write a file and to claim a folder, and the reading of JSON.

Files and new folders are complete or absent: they are written under a temporary name beside their
place and then renamed. A process that is killed leaves at most a hidden file, which is in nobody's
way.
"""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError
from cdcsr.locks import lock
from cdcsr.reading import read_text

JsonObject = dict[str, Any]
"""An object read from JSON; whoever reads it knows its values."""
_MARKER = ".cdcsr"
"""This file names the kind of a folder that :func:`new_folder` made."""


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, replacing one of that name; make missing folders on the way.

    Raises:
        CdcsrError: the file cannot be written.
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


def write_json(path: Path, data: object) -> None:
    """Write a JSON file, as :func:`write_bytes` does; NumPy arrays become lists, and their scalars
    numbers.

    Raises:
        ValueError: a number is NaN or infinite, which JSON cannot express.
    """
    write_text(path, json.dumps(data, indent=2, allow_nan=False, default=_plain) + "\n")


def read_json(path: Path) -> JsonObject:
    """Return the object in a JSON file.

    Raises:
        CdcsrError: the file cannot be read, or holds no JSON object.
    """
    try:
        data = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise CdcsrError(f"{path} cannot be read ({error}).") from None
    if not isinstance(data, dict):
        raise CdcsrError(f"{path} cannot be read (it should hold a JSON object).")
    return data


def refuse_unwritable(path: Path) -> None:
    """Check before long work whether a file can be written at its end; nothing is made.

    Raises:
        CdcsrError: the path is a folder, lies under a file, or in a folder that is read-only.
    """
    if path.is_dir():
        raise CdcsrError(f"{path} is a folder; give the name of a file.")
    above = next(folder for folder in path.absolute().parents if folder.exists())
    if not above.is_dir():
        raise CdcsrError(f"Cannot write {path}: {above} is a file.")
    if not os.access(above, os.W_OK):
        raise CdcsrError(f"Cannot write {path}: {above} may not be written to.")


@contextmanager
def new_folder(path: Path, kind: str, force: bool) -> Iterator[Path]:
    """Build a whole folder: fill the one that is yielded; it is put in place at the block's end.

    If the block fails, nothing of it is left, and the folder that it was to replace is still there.

    Args:
        path: the folder's place; missing folders on the way are made.
        kind: what the folder holds, a noun; a hidden file in it keeps the noun.
        force: replace a folder that is there already, if it is empty or of the same kind.

    Raises:
        CdcsrError: the place is taken, cannot be replaced, or cannot be written.
    """
    place = path.resolve()
    if place.exists():
        _refuse_replacing(path, kind, force)
    temporary = _beside(place)
    try:
        temporary.mkdir(parents=True)
    except OSError as error:
        raise _cannot_write(path, error) from None
    try:
        yield temporary
        (temporary / _MARKER).write_text(kind + "\n", "utf-8")
        _put_in_place(temporary, place)
    except BaseException as error:
        shutil.rmtree(temporary, ignore_errors=True)
        if isinstance(error, OSError):
            raise _cannot_write(path, error) from error
        raise


@dataclass(frozen=True)
class WorkingFolder:
    """A kind of folder for work that can be stopped and resumed, such as training.

    A record in the folder, a JSON object, says which work it holds. While a process works there it
    holds the lock `.lock`. Hidden files are ignored: a process that was killed may have left them.
    """

    kind: str
    """The name of the kind in messages, with an article: "a training run"."""
    record: str
    """The name of the record."""
    fields: frozenset[str] = frozenset()
    """Keys that every record of this kind has."""
    results: tuple[str, ...] = ()
    """Patterns of the files that are deleted, in this order, when the work begins anew."""

    @contextmanager
    def claim(
        self,
        folder: Path,
        identity: Mapping[str, object] | None = None,
        older: Callable[[dict[str, object]], dict[str, object]] | None = None,
        force: bool = False,
    ) -> Iterator[None]:
        """Make the folder, or check that it holds this work, and keep other processes out.

        Args:
            folder: where the work is done.
            identity: plain data that must be the same for the work to be resumed; it becomes the
                record. None resumes any work of this kind and leaves the record alone.
            older: translates the record of an older version to what this one would have written.
            force: begin anew where the folder holds other work of this kind.

        Raises:
            CdcsrError: the folder holds something else, or cannot be made.
            Busy: another process works there.
        """
        self.check(folder, identity, older, force)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _cannot_write(folder, error) from None
        with lock(folder / ".lock"):
            # Again, as the process that held the lock may have changed what is there.
            self.check(folder, identity, older, force)
            if force:
                self._delete_results(folder)
            record = folder / self.record
            if identity is not None:
                write_json(record, identity)
            elif not record.exists():
                write_json(record, {})
            yield

    def check(
        self,
        folder: Path,
        identity: Mapping[str, object] | None,
        older: Callable[[dict[str, object]], dict[str, object]] | None = None,
        force: bool = False,
    ) -> None:
        """Check that a folder is new or empty, or holds this work; arguments as for :meth:`claim`.

        Raises:
            CdcsrError: it holds something else; the message names the options that differ.
        """
        record = folder / self.record
        if not record.is_file():
            if folder.exists() and not (folder.is_dir() and _looks_empty(folder)):
                raise CdcsrError(f"{folder} exists and is not {self.kind}; give another folder.")
            return
        found = read_json(record)
        if not self.fields <= found.keys():
            raise CdcsrError(f"{folder} exists and is not {self.kind}; give another folder.")
        if force or identity is None:
            return
        ours, theirs = _flat(identity), _flat(older(found) if older else found)
        names = sorted(name for name in {*ours, *theirs} if ours.get(name) != theirs.get(name))
        if names:
            raise CdcsrError(
                f"{folder} holds {self.kind} with other options ({', '.join(names)}); give the "
                "same ones to resume it, another folder, or --force to begin anew."
            )

    def _delete_results(self, folder: Path) -> None:
        for path in [path for pattern in self.results for path in folder.glob(pattern)]:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise CdcsrError(f"Cannot delete {path}: {error.strerror}.") from None


def _refuse_replacing(path: Path, kind: str, force: bool) -> None:
    """Check that what is at `path` may be replaced by a folder of that kind."""
    if not path.is_dir():
        raise CdcsrError(f"{path} is a file; give the name of a folder.")
    if not force:
        raise CdcsrError(f"{path} already exists; give another folder, or --force to replace it.")
    if Path.cwd().is_relative_to(path.resolve()):
        raise CdcsrError(
            f"{path} holds the current folder and is not replaced; give another folder."
        )
    marker = path / _MARKER
    found = marker.read_text("utf-8", errors="replace").strip() if marker.is_file() else ""
    if found != kind and any(path.iterdir()):
        raise CdcsrError(
            f"{path} holds {found or 'files that this command did not make'}, not {kind}, and is "
            "not replaced; delete it yourself or give another folder."
        )


def _looks_empty(folder: Path) -> bool:
    """Return whether a folder holds nothing but hidden files."""
    return all(entry.name.startswith(".") for entry in folder.iterdir())


def _put_in_place(folder: Path, place: Path) -> None:
    """Rename `folder` to `place`; delete the one that was there once the new one stands."""
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


def _flat(data: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return nested mappings as one, its keys joined by dots."""
    flat: dict[str, object] = {}
    for key, value in data.items():
        name = prefix + key
        flat |= _flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return flat


def _beside(path: Path) -> Path:
    """Return a new hidden name beside `path`."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")


def _plain(value: object) -> object:
    """Return an array or a scalar of NumPy or torch as plain data."""
    tolist = getattr(value, "tolist", None)
    if callable(tolist):
        return tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON.")


def _cannot_write(path: Path, error: OSError) -> CdcsrError:
    return CdcsrError(f"Cannot write {path}: {error.strerror or error}.")
