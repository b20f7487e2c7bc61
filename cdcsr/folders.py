"""Folders that hold the outcome of one command: whole new ones, and ones for work in progress.

A new folder is complete or absent. Folders that hold anything else are never overwritten.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from cdcsr.errors import CdcsrError, cannot_write
from cdcsr.files import read_json, sealed, write_json
from cdcsr.leftovers import check_depth, remove, sweep, temporary_beside
from cdcsr.locks import Busy, lock, release_dead_locks

_MARKER = ".cdcsr"
"""This file names the kind of a folder that :func:`new_folder` made."""


@contextmanager
def new_folder(path: Path, kind: str, force: bool) -> Iterator[Path]:
    """Build a whole folder: fill the one that is yielded; it is put in place at the block's end.

    If the block fails, nothing of it is left, and the folder that it was to replace is still there.
    Meanwhile a lock beside the place keeps other processes from building a folder there. What
    appears there all the same is not replaced: then the new folder gets another name.

    Args:
        path: the folder's place; missing folders on the way are made.
        kind: what the folder holds, a noun; a hidden file in it keeps the noun.
        force: replace a folder that is there already, if it is empty or of the same kind.

    Raises:
        CdcsrError: the place is taken, cannot be replaced, or cannot be written.
    """
    try:
        place = path.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a zero byte
        raise cannot_write(path, OSError(str(error))) from None
    with _claimed(path, place):
        temporary = temporary_beside(place)
        try:
            _refuse_replacing(path, kind, force)
            temporary.mkdir()
            yield temporary
            (temporary / _MARKER).write_text(kind + "\n", "utf-8")
            found = _put_in_place(temporary, place, path, kind, force)
        except OSError as error:
            raise cannot_write(path, error) from error
        finally:
            remove(temporary)
    if found != place:
        raise CdcsrError(
            f"{path} appeared while this command ran and is not replaced; its own folder is "
            f"{found} now."
        )


@contextmanager
def _claimed(path: Path, place: Path) -> Iterator[None]:
    """Keep other processes from building a folder at a place, and clean up after dead ones."""
    with ExitStack() as held:
        try:
            held.enter_context(lock(place.with_name(f".{place.name}.lock")))
        except Busy as error:
            raise CdcsrError(
                f"Another process is making {path} now ({error}) Wait for it, or give another "
                "folder."
            ) from None
        sweep(place.parent)
        release_dead_locks(place.parent)
        old = _replaced(place)
        if old.exists():  # a process was killed while it replaced a folder
            if place.exists() and any(place.iterdir()):
                remove(old)
            else:
                old.rename(place)
        yield


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
        with self.hold(folder, identity, older, force) as begin:
            begin()
            yield

    @contextmanager
    def hold(
        self,
        folder: Path,
        identity: Mapping[str, object] | None = None,
        older: Callable[[dict[str, object]], dict[str, object]] | None = None,
        force: bool = False,
    ) -> Iterator[Callable[[], None]]:
        """Do as :meth:`claim`, but delete nothing and write no record before what is yielded is
        called; so several folders can be held before any of them changes."""
        self.check(folder, identity, older, force)
        with lock(folder / ".lock"):
            for place in (folder, *(each for each in folder.rglob("*") if each.is_dir())):
                sweep(place)
            # Again, as the process that held the lock may have changed what is there.
            self.check(folder, identity, older, force)

            def begin() -> None:
                if force:
                    self._delete_results(folder)
                record = folder / self.record
                if identity is not None:
                    write_json(record, sealed(identity))
                elif not record.exists():
                    write_json(record, sealed({}))

            yield begin

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
        try:
            check_depth(folder)
            there, empty = record.is_file(), _looks_empty(folder)
        except OSError as error:
            raise cannot_write(folder, error) from None
        if not there:
            if not empty:
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
    """Check that nothing is at `path`, or what may be replaced by a folder of that kind."""
    if not path.exists():
        return
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
    """Return whether there is no folder, or one that holds nothing but hidden files."""
    if not folder.exists():
        return True
    return folder.is_dir() and all(entry.name.startswith(".") for entry in folder.iterdir())


def _put_in_place(folder: Path, place: Path, path: Path, kind: str, force: bool) -> Path:
    """Rename `folder` to `place`, and return what it is called now.

    To rename a folder replaces an empty one silently. So the place is taken by an empty folder of
    our own first, which fails if anything is there.
    """
    old = _replaced(place)
    try:
        if force and place.exists():
            _refuse_replacing(path, kind, force)
            place.rename(old)
        place.mkdir()
        folder.rename(place)
    except (FileExistsError, CdcsrError):
        return _rename_beside(folder, place)
    except BaseException:
        if old.exists():
            old.rename(place)
        raise
    remove(old)
    return place


def _rename_beside(folder: Path, place: Path) -> Path:
    """Rename a finished folder to a free name like `place`, and return it."""
    for number in count(2):
        other = place.with_name(f"{place.name}-{number}")
        try:
            other.mkdir()
        except FileExistsError:
            continue
        return folder.rename(other)
    raise AssertionError


def _replaced(place: Path) -> Path:
    """Return the hidden name of the folder at a place while another one replaces it."""
    return place.with_name(f".{place.name}.replaced")


def _flat(data: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return nested mappings as one, its keys joined by dots."""
    flat: dict[str, object] = {}
    for key, value in data.items():
        name = prefix + key
        flat |= _flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return flat
