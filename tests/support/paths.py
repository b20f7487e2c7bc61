"""List a folder, and make the lock of a process that is dead."""

from __future__ import annotations

import json
import os
from pathlib import Path

DEAD = json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "started": "0", "token": "x"})
"""The content of a lock file; no system gives out so large a process number by default."""


def names(folder: Path) -> list[str]:
    """Return all names in a folder, hidden ones included."""
    return sorted(path.name for path in folder.iterdir())
