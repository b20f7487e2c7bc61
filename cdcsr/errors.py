"""Errors a user can cause. Each prints as one line and ends a command with its exit code."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class CdcsrError(Exception):
    """Something in what the user gave is wrong; the message says what, what is allowed, and what to do."""

    exit_code = 2
    """What a command that ends with it exits with."""


class CheckFailed(CdcsrError):
    """The command did its work, and what it was to check does not hold: exit code 1, as tests have it."""

    exit_code = 1


class Diverged(CdcsrError, FloatingPointError):
    """A simulation left the range in which its numbers mean anything.

    Attributes:
        copy: index of the first copy that diverged.
        time: simulated time of that copy, in [s].
    """

    def __init__(self, engine: str, copy: int, time: float, what: str) -> None:
        self.copy = copy
        self.time = time
        super().__init__(
            f"{engine}: copy {copy} diverged at t = {time:.4f} s ({what}); "
            "use a smaller time_step, or check the stiffnesses and masses in the robot description."
        )


def unknown_choice(kind: str, found: str, allowed: Iterable[str]) -> str:
    """The message for a name that is not one of those allowed, with the nearest one suggested."""
    names = sorted(allowed)
    close = difflib.get_close_matches(found, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return f"Unknown {kind} {found!r}.{hint} Available: {', '.join(names) or 'none'}."
