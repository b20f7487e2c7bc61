"""The `cdcsr` command. Each sub-command is an entry point in the group `cdcsr.commands`.

A sub-command is a function. Its typed signature is its command line (positional-only parameters are
positional arguments), and the first line of its docstring is its line in `cdcsr --help`. Modules
that hold commands import heavy packages only inside functions, so that this list appears quickly.
"""

from __future__ import annotations

import functools
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path
from typing import Any, ParamSpec, TextIO

from cdcsr.errors import CdcsrError, CdcsrWarning, missing_package, unknown_choice

_GROUP = "cdcsr.commands"
_FILE_OPTIONS = "json", "csv"
"""Options that name a file which a command writes at its end; `run` checks them at the start."""
_BROKEN_PIPE = 141
"""The exit code of a program whose output nobody reads any longer, as a shell reports it."""

_DEBUG = "CDCSR_DEBUG"
"""The environment variable with which an unforeseen error shows its traceback."""

_P = ParamSpec("_P")


class _Ended(BaseException):
    """Say which signal ends the program."""


def _end_with_output(function: Callable[_P, int]) -> Callable[_P, int]:
    """Make a function end quietly when the reader of its output has closed it, as `head` does, and
    in one line when the system refuses a call, such as writing to a full disk."""

    @functools.wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> int:
        try:
            code = function(*args, **kwargs)
            sys.stdout.flush()
        except OSError as error:
            try:
                print(flush=True)
            except OSError as refused:
                # Python flushes once more as it ends.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                if isinstance(refused, BrokenPipeError):
                    return _BROKEN_PIPE
                return _fail(f"Cannot write the output: {refused.strerror or refused}.")
            return _unforeseen(f"The system refused a call: {error}", error)
        return code

    return call


@_end_with_output
def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command.

    Args:
        argv: the arguments after `cdcsr`; by default those of this process.

    Returns:
        The exit code: 0; 1 if a check did not hold; 2 for an error of the user; 130 if interrupted,
        129 by SIGHUP, 143 by SIGTERM; 141 if nobody reads the output any longer.
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
    # Other packages may add commands, so any error may keep one from loading.
    except Exception as error:
        return _fail(f"The command {name!r} cannot be loaded: {_reason(error)}.")
    return run(function, f"cdcsr {name}", rest)


@_end_with_output
def run(function: Callable[..., Any], prog: str, argv: Sequence[str]) -> int:
    """Call a function with the arguments of a command line; every error becomes one line.

    If the environment variable CDCSR_DEBUG is set, an error that is not foreseen is raised instead.

    Args:
        function: its signature gives the options, and what it returns is ignored. Or a class that
            is made with `prog` and `argv` and reads them itself, for options that depend on other
            options; its method `run()` does the work.
        prog: what the user typed before `argv`, for usage lines.
        argv: the arguments.

    Returns:
        The exit code, as for :func:`main`.

    Raises:
        SystemExit: the user asked for help (0), or `argv` does not fit the signature (2).
    """
    import tyro

    try:
        with _cleaning_up(), _warnings_as_lines():
            if isinstance(function, type):
                command = function(prog, argv)
                _refuse_unwritable(vars(command))
                command.run()
            else:
                tyro.cli(_checking_files(function), prog=prog, args=list(argv))
    except CdcsrError as error:
        return _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except _Ended as ended:
        number = ended.args[0]
        return _say(f"ended by {signal.Signals(number).name}", 128 + number)
    except OSError:
        raise  # perhaps the output, of which the decorator knows
    except ModuleNotFoundError as error:
        missing = missing_package(f"`{prog}`", error)
        if missing is not None:
            return _fail(str(missing))
        return _unforeseen(f"Not foreseen: {_reason(error)}", error)
    except MemoryError as error:
        return _unforeseen(
            f"This machine's memory does not suffice: {str(error) or 'no details'}", error
        )
    except Exception as error:
        return _unforeseen(f"Not foreseen: {_reason(error)}", error)
    return 0


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print each of our warnings once, as one line."""
    said: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if not issubclass(category, CdcsrWarning):
            usual(message, category, filename, lineno, file, line)
        elif str(message) not in said:
            said.add(str(message))
            _say(f"warning: {message}", 0)

    with warnings.catch_warnings():
        usual, warnings.showwarning = warnings.showwarning, show
        warnings.simplefilter("always", CdcsrWarning)  # libraries make Python forget what it said
        yield


@contextmanager
def _cleaning_up() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the program as Ctrl-C does, by an exception: so locks are given
    back and temporary files deleted. A signal that is ignored, as under nohup, stays ignored."""
    ours: list[signal.Signals] = []

    def end(number: int, _: object) -> None:
        for each in ours:  # a second one would disturb the cleaning up
            signal.signal(each, signal.SIG_IGN)
        raise _Ended(number)

    try:
        if threading.current_thread() is threading.main_thread():
            for each in (signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(each) is signal.SIG_DFL:
                    ours.append(each)
                    signal.signal(each, end)
        yield
    finally:
        for each in ours:
            signal.signal(each, signal.SIG_DFL)


def _checking_files(function: Callable[..., object]) -> Callable[..., object]:
    """Make a function check the files that it writes at its end before it begins."""

    @functools.wraps(function)
    def call(*args: object, **kwargs: object) -> object:
        _refuse_unwritable(kwargs)
        return function(*args, **kwargs)

    return call


def _refuse_unwritable(options: Mapping[str, object]) -> None:
    from cdcsr.files import refuse_unwritable

    for name in _FILE_OPTIONS:
        path = options.get(name)
        if isinstance(path, Path):
            refuse_unwritable(path)


def _help(commands: Mapping[str, EntryPoint]) -> str:
    width = max((len(name) for name in commands), default=0)
    lines = [f"  {name:<{width}}  {_summary(point)}" for name, point in sorted(commands.items())]
    return "\n".join(
        [
            "usage: cdcsr COMMAND [OPTIONS]",
            "",
            "Cable-driven continuum space robots: models, demonstrations, training, and transfer",
            "between physics engines.",
            "",
            "commands:",
            *lines,
            "",
            "`cdcsr COMMAND --help` shows the options of a command, `cdcsr --version` the version.",
        ]
    )


def _summary(point: EntryPoint) -> str:
    """Return the first line of a command's docstring, or why the command cannot be loaded."""
    try:
        doc = point.load().__doc__ or ""
    except Exception as error:
        return f"(cannot be loaded: {_reason(error)})"
    return doc.strip().partition("\n")[0]


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")


def _unforeseen(message: str, error: Exception) -> int:
    """Report an error that nothing below has turned into a message for the user.

    Raises:
        Exception: the error itself, if the user wants to see the traceback.
    """
    if os.environ.get(_DEBUG):
        raise error
    return _fail(str(CdcsrError(f"{message.rstrip('.')}. Set {_DEBUG}=1 to see where.")))


def _fail(message: str, code: int = 2) -> int:
    return _say(f"error: {message}", code)


def _say(message: str, code: int) -> int:
    with suppress(OSError):
        print(f"cdcsr: {message}", file=sys.stderr)
    return code
