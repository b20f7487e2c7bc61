"""The memory that this process may still take, and the check that something fits into it."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from cdcsr.errors import CdcsrError

_GROUP = Path("/sys/fs/cgroup")
_MEMINFO = Path("/proc/meminfo")


def available_memory() -> float:
    """Return how many bytes this process may still take.

    That is what the machine has free, or what the process's control group (a container) leaves,
    whichever is less. Where the system does not tell, it is all memory that there is.
    """
    found = [float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")]
    with suppress(OSError):
        free = re.search(r"^MemAvailable: +(\d+) kB$", _MEMINFO.read_text(), re.MULTILINE)
        found += [1024.0 * int(free[1])] if free else []
    with suppress(OSError, ValueError):  # the limit is "max" where there is none
        limit = int((_GROUP / "memory.max").read_text())
        files = re.search(r"^inactive_file (\d+)$", (_GROUP / "memory.stat").read_text(), re.M)
        taken = int((_GROUP / "memory.current").read_text()) - (int(files[1]) if files else 0)
        found.append(float(limit - taken))
    return max(0.0, min(found))


def check_memory(what: str, needed: float, remedy: str, free: float | None = None) -> None:
    """Check that something fits into memory before it is made.

    Args:
        what: a noun with its figures.
        needed: an estimate in bytes.
        remedy: what the user can do.
        free: how many bytes there are; by default what this process may still take.

    Raises:
        CdcsrError: it does not fit.
    """
    if needed < 1e8:  # not worth the look
        return
    if needed > (free := available_memory() if free is None else free):
        raise CdcsrError(
            f"{what} would need about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are "
            f"free; {remedy}."
        )
