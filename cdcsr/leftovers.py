"""Temporary names that tell whose they are, and the removal of what dead processes have left.

A process that is killed cannot delete its temporary files. Their names hold the machine and the
process, so that the next process that writes into the same folder can tell that they are dead.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import socket
import uuid
from contextlib import suppress
from pathlib import Path

_NAME = re.compile(r"\.cdcsr-([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{8}(\.next)?")
"""Machine, process number, and when that process started."""

_DEEPEST = 256
"""The largest number of folders in a path."""


def temporary_beside(path: Path) -> Path:
    """Return a new hidden name in the folder of `path`; :func:`sweep` finds it again."""
    pid = os.getpid()
    name = f".cdcsr-{_machine()}-{pid}-{started(pid) or 0}-{uuid.uuid4().hex[:8]}"
    return path.with_name(name)


def make_folder(path: Path) -> None:
    """Make a folder and those above it, if they are missing.

    Raises:
        OSError: it cannot be made, or is deeper than Python, which goes up one by one, can follow.
    """
    check_depth(path)
    path.mkdir(parents=True, exist_ok=True)


def check_depth(path: Path) -> None:
    """Check that a path leads through at most 256 folders, and has no zero byte.

    Raises:
        OSError: it leads through more, or has one.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "it has a zero byte")
    if len(path.parts) > _DEEPEST:
        raise OSError(errno.ENAMETOOLONG, f"it leads through {len(path.parts)} folders")


def sweep(folder: Path) -> None:
    """Delete the temporary files and folders of dead processes of this machine in a folder."""
    with suppress(OSError):
        for entry in list(folder.iterdir()):
            found = _NAME.fullmatch(entry.name)
            if found and found[1] == _machine() and not is_running(int(found[2]), found[3]):
                remove(entry)


def remove(path: Path) -> None:
    """Delete a file or a whole folder; what cannot be deleted stays."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def is_running(pid: object, begun: object) -> bool:
    """Return whether a process of this machine lives that started at `begun`.

    Process numbers are used again, hence the start; where the system does not tell it, a number
    that is in use counts as the same process.
    """
    if not isinstance(pid, int):
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return str(started(pid) or 0) == str(begun or 0)


def started(pid: object) -> str | None:
    """Return when a process started, or None if the system does not tell or it is a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    state, *rest = stat.rpartition(")")[2].split()
    return None if state == "Z" else rest[18]


def _machine() -> str:
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
