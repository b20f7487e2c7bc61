"""One process at a time for each run, on this machine or on another that shares its folders."""

from __future__ import annotations

import json
import os
import socket
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cdcsr.errors import CdcsrError

HEARTBEAT = 5.0
"""Seconds between two signs of life of a lock's holder."""
STALE_AFTER = 60.0
"""Seconds without one after which a holder on another machine counts as dead."""


class Busy(CdcsrError):
    """Another process is at it."""

    exit_code = 75
    """EX_TEMPFAIL: try again later."""


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Hold the lock `path`; that of a process that died is taken over.

    A holder on this machine is dead if its process is gone; one on another machine if it has not touched the file
    for :data:`STALE_AFTER` seconds.

    Raises:
        Busy: a live process holds it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    token = uuid.uuid4().hex
    holder = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "started": _started(os.getpid()),
        "token": token,
    }
    mine = path.with_name(f".{path.name}.{token[:8]}")
    done = threading.Event()
    beat = threading.Thread(target=_keep_alive, args=(path, done), daemon=True)
    try:  # a signal may end this process anywhere in here
        mine.write_text(json.dumps(holder))
        _take(path, mine)
        mine.unlink(missing_ok=True)  # now, as a killed process leaves it otherwise
        beat.start()
        yield
    finally:
        done.set()
        if beat.is_alive():
            beat.join()
        mine.unlink(missing_ok=True)
        if _holder(path).get("token") == token:
            path.unlink(missing_ok=True)


def _take(path: Path, mine: Path) -> None:
    """Give `mine` the name `path`. A link is made or not made, at once, also on a network's file system.

    A dead lock is replaced, also at once, by the one who holds another lock, whose turn it is to do so. Nobody else
    may, and the dead does not, so what he has seen dead is what he replaces. Had he died at it, his turn is taken over
    likewise.

    Raises:
        Busy: a live process holds it, or is taking it over.
    """
    for _ in range(10):
        with suppress(FileExistsError):
            path.hardlink_to(mine)
            return
        if _is_stale(path):
            turn = path.with_name(f".{path.name}.next")
            own = mine.with_name(
                f"{mine.name}.next"
            )  # a second name, as the first is used up where it replaces
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
            break  # else it was given back just now
    holder = _holder(path)
    raise Busy(f"{path} is held by the live process {holder.get('pid')} on {holder.get('host')}.")


def _is_stale(path: Path) -> bool:
    """Whether there is a lock whose holder is dead."""
    holder = _holder(path)
    if holder.get("host") == socket.gethostname():
        pid = holder.get("pid")
        return not _is_alive(pid) or _started(pid) != holder.get("started")
    probe = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
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


def _is_alive(pid: object) -> bool:
    if not isinstance(pid, int):
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _started(pid: object) -> str | None:
    """When a process started, where the system tells: its number may be given again."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    state, *rest = stat.rpartition(")")[2].split()
    return None if state == "Z" else rest[18]


def _keep_alive(path: Path, done: threading.Event) -> None:
    while not done.wait(HEARTBEAT):
        with suppress(OSError):
            os.utime(path)
