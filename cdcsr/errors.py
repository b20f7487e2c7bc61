"""Errors that a user can cause. Each prints as one line and ends a command with its exit code."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

_LONGEST = 1_900
"""The length at which a message is cut; input can be quoted in it."""


_OURS = ("cdcsr", "backends", "controllers", "training", "models")
_PACKAGES = {"PIL": "pillow", "warp": "warp-lang"}
"""Packages that do not have the name of their module."""


class CdcsrError(Exception):
    """Report what is wrong in the input, what is allowed, and what to do.

    Args:
        message: it becomes one printable line; the middle of a long one is left out.
    """

    exit_code = 2
    """The exit code of a command that ends with this error."""

    def __init__(self, message: str) -> None:
        if len(message) > _LONGEST:
            message = f"{message[: _LONGEST - 600]} [...] {message[-500:]}"
        line = " ".join(message.split("\n"))
        super().__init__("".join(c if c.isprintable() else "?" for c in line))


class CdcsrWarning(UserWarning):
    """Tell what may make a result wrong, and what to do; a command prints it as one line."""


class CheckFailed(CdcsrError):
    """Report that a command did its work, but a check did not hold; exit code 1, as for tests."""

    exit_code = 1


class Diverged(CdcsrError, FloatingPointError):
    """Report that a simulation left the range in which its numbers mean anything.

    Attributes:
        copy: the index of the first copy that diverged.
        copies: the indices of all copies that diverged in this step.
        time: the simulated time of the first, in [s].
        engine: the engine's name.
        what: how it shows.
    """

    def __init__(
        self, engine: str, copy: int, time: float, what: str, copies: Iterable[int] = ()
    ) -> None:
        self.copy = copy
        self.copies = tuple(sorted({copy, *copies}))
        self.time, self.engine, self.what = time, engine, what
        super().__init__(
            f"{engine}: copy {copy} diverged at t = {time:.4f} s ({what}); "
            "use a smaller time_step, or check the stiffnesses and masses in the robot description."
        )


class MissingPackage(CdcsrError):
    """Report that a package is not installed, or that its version lacks a module."""


def missing_package(who: str, error: ModuleNotFoundError) -> MissingPackage | None:
    """Return the error for a module that is not there; None if it is one of this project.

    Args:
        who: what needs it.
        error: what the import raised.
    """
    module = error.name or ""
    package = module.partition(".")[0]
    if not package or package in _OURS:
        return None
    install = _PACKAGES.get(package, package.replace("_", "-"))
    if module == package:
        return MissingPackage(
            f"{who} needs the package {install}, which is not installed: pip install {install}."
        )
    return MissingPackage(
        f"{who} needs {module}, which the installed {install} lacks: "
        f"pip install --upgrade {install}."
    )


def cannot_write(path: Path, error: OSError) -> CdcsrError:
    """Return the error for a file or a folder that cannot be written."""
    return CdcsrError(f"Cannot write {path}: {error.strerror or error}.")


def unknown_choice(kind: str, found: object, allowed: Iterable[str]) -> str:
    """Return the message for a name that is not allowed; it suggests the most similar one."""
    names = sorted(allowed)
    close = difflib.get_close_matches(str(found)[:100], names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    shown = repr(found) if len(repr(found)) < 100 else f"{repr(found)[:100]}..."
    return f"Unknown {kind} {shown}.{hint} Available: {', '.join(names) or 'none'}."
