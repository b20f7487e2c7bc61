"""Locks between processes, on one machine or on several that share a file system."""

from __future__ import annotations

import json
import os
import socket
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cdcsr.errors import CdcsrError, cannot_write
from cdcsr.leftovers import is_running, make_folder, started, sweep, temporary_beside

HEARTBEAT = 5.0
"""Seconds between two signs of life of the process that holds a lock."""
STALE_AFTER = 60.0
"""A holder on another machine counts as dead after so many seconds without a sign of life."""


class Busy(CdcsrError):
    """Report that another process holds the lock."""

    exit_code = 75
    """EX_TEMPFAIL: try again later."""


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Hold the lock file `path` while the block runs; take it over from a process that died.

    A holder on this machine is dead if its process is gone, one on another machine if it has not
    touched the file for :data:`STALE_AFTER` seconds.

    Raises:
        Busy: a live process holds it.
        CdcsrError: the file cannot be written.
    """
    token = uuid.uuid4().hex
    holder = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "started": started(os.getpid()),
        "token": token,
    }
    mine = temporary_beside(path)
    done = threading.Event()
    beat = threading.Thread(target=_keep_alive, args=(path, done), daemon=True)
    try:  # a signal may end this process at any point here
        try:
            make_folder(path.parent)
            mine.write_text(json.dumps(holder))
            _take(path, mine)
            mine.unlink(missing_ok=True)  # now, as a killed process would leave it behind
            sweep(path.parent)
            turn = _turn(path)
            if turn.exists() and _is_stale(turn):  # killed while it took a lock over
                turn.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_write(path, error) from None
        beat.start()
        yield
    finally:
        done.set()
        if beat.is_alive():
            beat.join()
        with suppress(OSError):  # such as a folder that has vanished
            mine.unlink(missing_ok=True)
            if _holder(path).get("token") == token:
                path.unlink(missing_ok=True)


def release_dead_locks(folder: Path) -> None:
    """Delete the hidden lock files in a folder whose holders are dead."""
    for path in folder.glob(".*.lock"):
        if _holder(path).get("token") and _is_stale(path):
            with suppress(Busy), lock(path):
                pass


def _take(path: Path, mine: Path) -> None:
    """Give the file `mine` the name `path` by a hard link, which is atomic on network disks too.

    To replace the lock of a dead process, a process must first hold a second lock, `next`. Nobody
    else may replace the first lock meanwhile, so the lock that was seen dead is the one that is
    replaced. If the process dies with the second lock, that is taken over in the same way.

    Raises:
        Busy: a live process holds the lock, or is taking it over.
    """
    for _ in range(10):
        with suppress(FileExistsError):
            path.hardlink_to(mine)
            return
        if _is_stale(path):
            turn = _turn(path)
            # A second name of the same file, as `replace` below uses up the first.
            own = mine.with_name(f"{mine.name}.next")
            own.hardlink_to(mine)
            try:
                _take(turn, own)
            finally:
                own.unlink(missing_ok=True)
            try:
                if _is_stale(path):
                    mine.replace(path)
                    return
            finally:
                turn.unlink()
        elif path.exists():
            break  # otherwise it was given back just now
    holder = _holder(path)
    raise Busy(f"{path} is held by the live process {holder.get('pid')} on {holder.get('host')}.")


def _turn(path: Path) -> Path:
    """Return the lock that a process holds while it takes over the lock `path`."""
    return path.with_name(f".{path.name}.next")


def _is_stale(path: Path) -> bool:
    """Return whether there is a lock whose holder is dead."""
    holder = _holder(path)
    if holder.get("host") == socket.gethostname():
        return not is_running(holder.get("pid"), holder.get("started"))
    probe = temporary_beside(path)
    try:
        probe.touch()  # the clock of the file system, not of this machine
        return probe.stat().st_mtime - path.stat().st_mtime > STALE_AFTER
    except FileNotFoundError:
        return False
    finally:
        probe.unlink(missing_ok=True)


def _holder(path: Path) -> dict[str, int | str | None]:
    try:
        return dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError):
        return {}


def _keep_alive(path: Path, done: threading.Event) -> None:
    while not done.wait(HEARTBEAT):
        with suppress(OSError):
            os.utime(path)
