"""The `cdcsr` command. It knows no sub-command: each is an entry point in the group `cdcsr.commands`.

A sub-command is a plain function. Its typed signature is its command line (positional-only parameters are
positional), the first line of its docstring is its line in `cdcsr --help`. Modules that hold commands import
what is heavy inside the functions, so that listing them stays quick.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points, version
from typing import Any, ParamSpec

from cdcsr.errors import CdcsrError, unknown_choice

_GROUP = "cdcsr.commands"
_REPORTS = "json", "csv"
"""Options that name a file which a command writes when its work is done; `run` looks before it begins if it can."""


_P = ParamSpec("_P")


def _may_go_unread(function: Callable[_P, int]) -> Callable[_P, int]:
    """End quietly where whoever reads the output has seen enough, as `| head` has."""

    @functools.wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> int:
        try:
            code = function(*args, **kwargs)
            sys.stdout.flush()
        except BrokenPipeError:
            try:
                print(flush=True)
            except BrokenPipeError:
                os.dup2(
                    os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
                )  # Python flushes once more as it ends
                return 141
            raise  # some other pipe
        return code

    return call


@_may_go_unread
def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command.

    Args:
        argv: the arguments after `cdcsr`; by default those of this process.

    Returns:
        The exit code: 0, or 1 if a check did not hold, or 2 for an error of the user's, or 130 if interrupted, or
        141 if nobody reads the output any longer.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    commands = {point.name: point for point in entry_points(group=_GROUP)}
    if not arguments:
        print(_help(commands), file=sys.stderr)
        return 2
    name, *rest = arguments
    if name in ("-h", "--help"):
        print(_help(commands))
        return 0
    if name == "--version":
        print(f"cdcsr {version('cdcsr')}")
        return 0
    if name not in commands:
        return _fail(unknown_choice("command", name, commands))
    try:
        function = commands[name].load()
    # The module may be anyone's: whatever keeps it from loading is shown as the reason.
    except Exception as error:
        return _fail(f"The command {name!r} cannot be loaded: {_reason(error)}.")
    return run(function, f"cdcsr {name}", rest)


@_may_go_unread
def run(function: Callable[..., Any], prog: str, argv: Sequence[str]) -> int:
    """Call a function with arguments from a command line, and turn its errors into one line and an exit code.

    Args:
        function: its signature gives the options; what it returns is ignored. Or a dataclass with `run()`, and a
            classmethod `defaults(argv)` for options whose default depends on another (a preset).
        prog: what the user typed before `argv`, for usage lines.
        argv: the arguments.

    Returns:
        The exit code, as for :func:`main`.

    Raises:
        SystemExit: help was asked for (0), or `argv` does not fit the signature (2).
    """
    import tyro

    try:
        defaults = getattr(function, "defaults", None)
        result = tyro.cli(
            function if defaults else _refusing_unwritable(function),
            prog=prog,
            args=list(argv),
            default=defaults(argv) if defaults else tyro.MISSING,
        )
        if defaults:
            _refuse_unwritable(vars(result))
            result.run()
    except CdcsrError as error:
        return _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        print("cdcsr: interrupted", file=sys.stderr)
        return 130
    return 0


def _refusing_unwritable(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        _refuse_unwritable(kwargs)
        return function(*args, **kwargs)

    return call


def _refuse_unwritable(options: Mapping[str, Any]) -> None:
    from cdcsr.files import refuse_unwritable

    for name in _REPORTS:
        if options.get(name) is not None:
            refuse_unwritable(options[name])


def _help(commands: dict[str, EntryPoint]) -> str:
    width = max((len(name) for name in commands), default=0)
    lines = [f"  {name:<{width}}  {_summary(point)}" for name, point in sorted(commands.items())]
    return "\n".join(
        [
            "usage: cdcsr COMMAND [OPTIONS]",
            "",
            "Cable-driven continuum space robots: models, demonstrations, training, and transfer between engines.",
            "",
            "commands:",
            *lines,
            "",
            "`cdcsr COMMAND --help` shows the options of a command, `cdcsr --version` the version.",
        ]
    )


def _summary(point: EntryPoint) -> str:
    """The first line of a command's docstring, or why it cannot be loaded."""
    try:
        doc = point.load().__doc__ or ""
    except Exception as error:
        return f"(cannot be loaded: {_reason(error)})"
    return doc.strip().partition("\n")[0]


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")


def _fail(message: str, code: int = 2) -> int:
    print(f"cdcsr: error: {message}", file=sys.stderr)
    return code
