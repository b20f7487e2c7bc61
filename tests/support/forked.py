"""Commands in forked processes, whose writing fails, or which are killed, where a test says."""

from __future__ import annotations

import builtins
import errno
import io
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cdcsr import cli

_FREEING = ("os.remove", "os.rmdir")
_EVENTS = {"os.rename": 2, "os.mkdir": 1, "os.link": 2} | dict.fromkeys(_FREEING, 1)
"""Audit events of calls that change a folder, and how many of their arguments are paths."""


@dataclass(frozen=True)
class Fault:
    """A fault at one moment of a command, counted in its writing calls or in seconds."""

    kind: str
    """full, read-only, vanished, kill, size (no file may grow beyond `at` bytes) or late (killed
    after `at` seconds)."""
    at: float

    def happen(self, count: int, folder: Path, event: str) -> None:
        """Do what this is at the call of that number."""
        if count < self.at:
            return
        needs_room = event not in _FREEING and (event != "os.rename" or count == self.at)
        if self.kind == "full" and needs_room:  # a full disk stays full
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self.kind == "read-only":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        if count > self.at:
            return
        if self.kind == "vanished":
            shutil.rmtree(folder, ignore_errors=True)
        if self.kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    """The exit code; negative if it was killed."""
    errors: list[str]
    """Lines of the standard error, without notes."""
    calls: int
    """How often it wrote, if it was not killed."""


def forked(do: Callable[[], object], folder: Path, fault: Fault | None = None) -> Outcome:
    """Call a function as a command of the program in a process of its own.

    Args:
        do: the function.
        folder: writing calls below it are counted.
        fault: what happens there; by default nothing.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _child(do, folder, fault, writing)
    os.close(writing)
    if fault is not None and fault.kind == "late":
        time.sleep(fault.at)
        os.kill(child, signal.SIGKILL)
    with os.fdopen(reading, encoding="utf-8", errors="replace") as file:
        *lines, last = file.read().split("\n")
    _, status = os.waitpid(child, 0)
    calls = int(last) if last.isdecimal() else 0
    errors = [line for line in lines if line and not line.startswith("cdcsr: note:")]
    return Outcome(os.waitstatus_to_exitcode(status), errors, calls)


def _child(do: Callable[[], object], folder: Path, fault: Fault | None, writing: int) -> None:
    code, counter = 70, _Counter(folder, fault)
    try:
        os.dup2(writing, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115
        if fault is not None and fault.kind == "size":
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(fault.at), int(fault.at)))
        counter.install()

        def command() -> None:
            do()

        code = cli.run(command, "cdcsr", [])
    except BaseException:  # also SystemExit, which no command may end with
        traceback.print_exc()
    finally:
        sys.stderr.write(str(counter.count))
        sys.stderr.flush()
        os._exit(code)


class _Counter:
    """Counts calls that write below a folder, and lets the fault happen there."""

    def __init__(self, folder: Path, fault: Fault | None) -> None:
        self._folder, self._fault, self.count = folder, fault, 0
        self._inside = False

    def install(self) -> None:
        """Watch this process from now on."""
        sys.addaudithook(self._audit)
        plain = io.open

        def watched(file: object, mode: str = "r", *args: object, **options: object) -> object:
            found = plain(file, mode, *args, **options)  # type: ignore[call-overload]
            if set(mode) & set("wax+") and self._is_ours(file):
                write = found.write

                def counted(data: object) -> object:
                    self._happen("write")
                    return write(data)

                return _Watched(found, counted)
            return found

        io.open = builtins.open = watched  # type: ignore[assignment]

    def _audit(self, event: str, arguments: tuple[object, ...]) -> None:
        if event == "open":
            _, mode, flags = arguments
            writes = (isinstance(mode, str) and bool(set(mode) & set("wax+"))) or (
                mode is None and isinstance(flags, int) and bool(flags & os.O_CREAT)
            )
            paths = arguments[:1] if writes else ()
        else:
            paths = arguments[: _EVENTS.get(event, 0)]
        if any(map(self._is_ours, paths)):
            self._happen(event)

    def _is_ours(self, path: object) -> bool:
        return isinstance(path, str | Path) and Path(path).is_relative_to(self._folder)

    def _happen(self, event: str) -> None:
        if self._inside:
            return
        self.count += 1
        if self._fault is not None:
            self._inside = True
            try:
                self._fault.happen(self.count, self._folder, event)
            finally:
                self._inside = False


class _Watched:
    """A file whose `write` is another function."""

    def __init__(self, file: io.IOBase, write: Callable[[object], object]) -> None:
        self._file, self.write = file, write

    def __enter__(self) -> _Watched:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)
