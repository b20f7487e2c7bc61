"""The `cdcsr` command answers quickly and never with a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest

from cdcsr import cli
from cdcsr.errors import CdcsrError
from cdcsr.files import refuse_unwritable

SCRIPT = str(Path(sys.executable).with_name("cdcsr"))
HEAVY = (
    "pydantic",
    "scipy",
    "torch",
    "trimesh",
    "tyro",
    "numba",
    "matplotlib",
    "minari",
    "mujoco",
    "pybullet",
)
"""Modules that `cdcsr --help` must not import. Gymnasium and NumPy are imported with `cdcsr`, which
registers the environments."""


def double(number: int, /, *, quiet: bool = False) -> None:
    """Print twice a number.

    Args:
        number: any whole number.
        quiet: print nothing.
    """
    if not quiet:
        print(2 * number)


def measure(*, json: Path | None = None, csv: Path | None = None) -> None:
    """Say that work was done."""
    print("worked", json, csv)


def fail() -> None:
    """Fail because of the user's input."""
    raise CdcsrError("There is no such thing; have another.")


def interrupt() -> None:
    """Fail because of Ctrl-C."""
    raise KeyboardInterrupt


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the functions above as commands, and one whose module does not exist."""
    found = [
        EntryPoint(f.__name__, f"{__name__}:{f.__name__}", "cdcsr.commands")
        for f in (double, fail, interrupt)
    ]
    found.append(EntryPoint("gone", "no_such_module:function", "cdcsr.commands"))

    def installed(*, group: str) -> list[EntryPoint]:
        assert group == "cdcsr.commands"
        return found

    monkeypatch.setattr(cli, "entry_points", installed)


def fastest(command: list[str]) -> float:
    """Return the shortest of five runs of a command, in [s]; other programs delay the others."""

    def once() -> float:
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        return time.perf_counter() - start

    return min(once() for _ in range(5))


def test_help_takes_less_than_half_a_second() -> None:
    # An empty Python program takes about 15 ms; a slower machine gets more time in proportion.
    floor = fastest([sys.executable, "-c", "pass"])
    assert fastest([SCRIPT, "--help"]) < max(0.5, 20 * floor)


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, cdcsr.cli; cdcsr.cli.main(['--help']); "
    code += f"print([module for module in {HEAVY} if module in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    "command", sorted({point.name for point in entry_points(group="cdcsr.commands")})
)
def test_every_installed_command_explains_itself(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main([command, "--help"])
    assert stopped.value.code == 0
    assert f"usage: cdcsr {command}" in capsys.readouterr().out


def test_an_unknown_command_ends_in_one_line_and_exit_code_2() -> None:
    done = subprocess.run([SCRIPT, "biuld-model"], check=False, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(
        "cdcsr: error: Unknown command 'biuld-model'. Did you mean 'build-model'? Available: "
    )


@pytest.mark.usefixtures("commands")
def test_help_lists_every_command_even_if_one_cannot_be_loaded(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["--help"]) == 0
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith("  ")] == [
        "  double     Print twice a number.",
        "  fail       Fail because of the user's input.",
        "  gone       (cannot be loaded: ModuleNotFoundError: No module named 'no_such_module')",
        "  interrupt  Fail because of Ctrl-C.",
    ]


@pytest.mark.usefixtures("commands")
def test_no_command_is_an_error_with_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    assert "usage: cdcsr COMMAND" in capsys.readouterr().err


@pytest.mark.usefixtures("commands")
@pytest.mark.parametrize(
    ("argv", "code", "out", "err"),
    [
        (["double", "21"], 0, "42\n", ""),
        (["double", "21", "--quiet"], 0, "", ""),
        (["fail"], 2, "", "error: There is no such thing; have another.\n"),
        (["interrupt"], 130, "", "interrupted\n"),
        (
            ["gone"],
            2,
            "",
            "error: The command 'gone' cannot be loaded: ModuleNotFoundError: "
            "No module named 'no_such_module'.\n",
        ),
        (
            ["duoble"],
            2,
            "",
            "error: Unknown command 'duoble'. Did you mean 'double'? "
            "Available: double, fail, gone, interrupt.\n",
        ),
    ],
)
def test_exit_codes_and_output(
    argv: list[str], code: int, out: str, err: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(argv) == code
    assert capsys.readouterr() == (out, err and f"cdcsr: {err}")


@pytest.mark.parametrize("argv", [[], ["many"], ["1", "--loud"]])
def test_arguments_that_do_not_fit_end_with_exit_code_2(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.run(double, "double", argv)
    assert stopped.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err


@pytest.mark.parametrize("argv", [["--help"], ["build-model", "--help"]])
def test_a_closed_output_ends_the_command_without_a_message(argv: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([SCRIPT, *argv], stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (BrokenPipeError("of a worker"), "The system refused a call: of a worker"),
        (MemoryError(), "This machine's memory does not suffice: no details"),
        (RecursionError("too deep"), "Not foreseen: RecursionError: too deep"),
        (OverflowError("too\nlarge"), "Not foreseen: OverflowError: too large"),
        (ZeroDivisionError("by zero."), "Not foreseen: ZeroDivisionError: by zero"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_what_is_not_foreseen_is_one_line_and_on_demand_a_traceback(
    error: Exception, said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise error

    assert cli.run(fail, "fail", []) == 2
    expected = f"cdcsr: error: {said}. Set CDCSR_DEBUG=1 to see where.\n"
    assert capsys.readouterr() == ("\n" if isinstance(error, OSError) else "", expected)
    monkeypatch.setenv("CDCSR_DEBUG", "1")
    with pytest.raises(type(error)):
        cli.run(fail, "fail", [])


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("cdcsr ")


def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    for option, place, why in (
        ("--json", tmp_path, f"{tmp_path} is a folder; give the name of a file."),
        (
            "--csv",
            tmp_path / "file" / "x.csv",
            f"Cannot write {tmp_path}/file/x.csv: {tmp_path}/file is a file.",
        ),
    ):
        assert cli.run(measure, "measure", [option, str(place)]) == 2
        assert capsys.readouterr() == ("", f"cdcsr: error: {why}\n")
    new = tmp_path / "new" / "x.json"
    assert cli.run(measure, "measure", ["--json", str(new)]) == 0
    assert capsys.readouterr().out == f"worked {new} None\n"
    assert not new.parent.exists()  # checking makes nothing


def test_a_folder_without_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A test that runs as root has every permission.
    monkeypatch.setattr(os, "access", lambda path, mode: (path, mode) != (tmp_path, os.W_OK))
    with pytest.raises(CdcsrError, match="may not be written to"):
        refuse_unwritable(tmp_path / "x.json")


def test_a_full_disk_under_the_output_is_one_line() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run([SCRIPT, "--help"], stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 2
    assert done.stderr == b"cdcsr: error: Cannot write the output: No space left on device.\n"


def test_a_call_that_the_system_refuses_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def read() -> None:
        raise PermissionError(13, "Permission denied", "notes")

    assert cli.run(read, "read", []) == 2
    assert capsys.readouterr().err == (
        "cdcsr: error: The system refused a call: [Errno 13] Permission denied: 'notes'. "
        "Set CDCSR_DEBUG=1 to see where.\n"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_signal_that_ends_a_command_cleans_up(tmp_path: Path, number: signal.Signals) -> None:
    code = (
        "import signal, sys, time; from pathlib import Path; from cdcsr import cli; "
        "from cdcsr.folders import new_folder\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # nohup ignores it in all that it starts
        "def work(out: Path, /) -> None:\n"
        "    with new_folder(out, 'models', False) as folder:\n"
        "        (folder / 'half').touch(); print('ready', flush=True); time.sleep(60)\n"
        "sys.exit(cli.run(work, 'work', sys.argv[1:]))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    assert len(list(tmp_path.iterdir())) == 2  # the folder in the making, and the lock
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    word = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
    assert said.decode() == f"cdcsr: {word}\n"
    assert list(tmp_path.iterdir()) == []


def test_an_ignored_signal_stays_ignored(capsys: pytest.CaptureFixture[str]) -> None:
    def look() -> None:
        print([signal.getsignal(n) for n in (signal.SIGHUP, signal.SIGTERM)])

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert cli.run(look, "look", []) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert capsys.readouterr().out.startswith("[<Handlers.SIG_IGN: 1>, <function ")
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
