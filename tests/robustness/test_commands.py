"""Wrong arguments of every command end in one short line, and change no file that is there.

A case is a command that works, with one argument replaced by a wrong one. Which arguments there
are, and of which kind, is read off the signatures, so new commands and options are found.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import random
import re
import signal
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import NamedTuple

import pytest

from cdcsr.cli import run
from training.experiments import experiments
from training.report import report

LONG = "x" * 300
NUMBERS = [
    "",
    "x",
    "nan",
    "inf",
    "-inf",
    "-1",
    "1e400",
    "9" * 400,
    "1.5.2",
    "0x1g",
    "1,5",
    "²",
    "--",
]
PATHS = [
    "",
    "file.json/x",
    "/dev/null/x",
    LONG,
    "loop/x",
    "a/" * 2_000 + "x",
    "full",
]
"""None of these can be written; `full` is a folder with files in it."""
NAMES = [
    "",
    "nobody",
    LONG,
    "../../x",
    "a\nb",
    "\x1b[31m",
    "/",
    "ß",
    "'; rm -rf /",
    "-",
    "%s{}",
    "💥",
]
INPUTS = ["none", "file.json", "full", "/dev/zero", "fifo", "loop", "broken.toml", LONG, "."]
KINDS: dict[str, list[str]] = {
    "robot": [*(f"{one}.toml" for one in ("none", LONG, "folder", "pipe", "zeros")), *NAMES],
    "backend": [
        "mujoco:x=1",
        "pybullet:substeps=0",
        "mujoco:",
        "a+b",
        "mujoco+",
        "all,all",
        *NAMES,
    ],
    "space": ["none.npz", "broken.npz", "folder.npz", "pipe.npz", f"{LONG}.npz", *NAMES],
    "policy": [
        "nearest:none",
        "json:none",
        ":x",
        "x:",
        "os:getcwd",
        "none.zip",
        "bad.zip",
        *INPUTS,
    ],
    "seed": [*NUMBERS, str(2**63), str(10**30)],
    "spacing": [*NUMBERS, "0", "1e-9", "1e9"],
    "minutes": [*NUMBERS, "0", "1e9"],
    "jobs": [*NUMBERS, "0", "1000000"],
}
KINDS |= {"policies": KINDS["policy"], "space_names": KINDS["space"]}
SMALL = "--backend mujoco --robot planar-single --episodes 1"
WORKING = {
    "build-model": "planar-single --out new --backend mujoco",
    "demonstrate": f"--out new --frame-skip 10 {SMALL}",
    "replay": "full --backend mujoco --robot planar-single",
    "engines": "--robot planar-single",
    "parity": "planar-single --episodes 1 --backend pybullet",
    "workspace": "planar-single --out new.npz --spacing 0.5 --frame-skip 50",
    "evaluate": f"jacobian {SMALL} --space anchor",
    "transfer": "jacobian --backend mujoco --episodes 1 --space anchor",
    "sweep": f"jacobian {SMALL} --axis link_mass --space anchor",
    "search": f"jacobian --out new --rounds 1 {SMALL} --space anchor",
    "experiments": "table2 --list --budget quick --store full",
    "validate": "cosserat none",
    "doctor": "",
    "export": "nobody --out new.onnx",
    "plot": "matrix full --out new.png",
    "film": "jacobian --out new.gif --robot planar-single --width 32 --seconds 0.01 --targets 1",
    "demo": "--out new --minutes 1",
    "bench": "none",
    "train": "--out new --algorithm bc --robot planar-single --learner.bc-updates 1",
    "report": "--results none --out new",
}
"""Command lines that work, or are refused, and take little time; commands that are not here get
only arguments that no command takes."""
TRAIN = ["robot", "backend", "space", "task", "start", "seed", "out", "json", "algorithm", "preset"]
NUMBERS_OF_TRAIN = ["frame-skip", "randomize", "num-demonstrations", "evaluate-every", "stop-after"]
NUMBERS_OF_TRAIN += [f"learner.{name}" for name in ("hidden", "batch-size", "critics", "capacity")]
NEVER = ["--frobnicate", "--json", "---", "--=", "--episodes=x", "--ß", "--json=full"]
Case = tuple[str, list[str]]


class Program(NamedTuple):
    """A function that `cdcsr.cli.run` runs under a name."""

    name: str
    function: Callable[..., object]


def programs() -> dict[str, Program]:
    """Return all commands and programs by their names."""
    found = {one.name: Program(f"cdcsr {one.name}", one.load()) for one in COMMANDS}
    found["training.experiments"] = Program("training.experiments", experiments)
    return found | {"report": Program("training.report", report)}


COMMANDS = sorted(entry_points(group="cdcsr.commands"), key=lambda one: one.name)


def wrong_values(name: str, annotation: str) -> list[str]:
    """Return wrong values of an option by its name and the text of its type."""
    if name in KINDS:
        return KINDS[name]
    if name == "plot":  # of some commands it is a folder, which may be the current one
        return PATHS[1:-1]
    if "int" in annotation or "float" in annotation:
        return NUMBERS
    if "Path" in annotation:
        return INPUTS if name in ("dataset", "folder", "results", "store") else PATHS
    return NAMES


def cases() -> Iterator[Case]:
    """Yield the name of a program and its arguments."""
    for name, program in programs().items():
        working = WORKING.get(name, WORKING["experiments"] if "experiments" in name else "").split()
        for never in NEVER:
            yield name, [*working, never]
        yield name, [*working, "surplus", "surplus", "surplus"]
        if name == "train":
            for option in (*TRAIN, *NUMBERS_OF_TRAIN):
                kind = "int" if option in NUMBERS_OF_TRAIN else "str"
                kind = "Path" if option in ("out", "json") else kind
                for value in wrong_values(option, kind):
                    yield name, [*working, f"--{option}={value}"]
        elif working or name in WORKING:
            yield from cases_of(name, program.function, working)


def cases_of(name: str, function: Callable[..., object], working: list[str]) -> Iterator[Case]:
    """Yield the cases of a function whose signature is its command line."""
    for parameter in inspect.signature(function).parameters.values():
        option = f"--{parameter.name.replace('_', '-')}"
        annotation = str(parameter.annotation)
        if annotation == "bool":
            yield name, [*working, f"{option}=maybe"]
            continue
        for value in wrong_values(parameter.name, annotation):
            if parameter.kind is inspect.Parameter.POSITIONAL_ONLY:
                yield name, [value, *working[1:]]
            else:
                rest = re.sub(rf"{option} \S+", "", " ".join(working)).split()
                yield name, [*rest, f"{option}={value}"]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder with files of many kinds, and work in it."""
    (tmp_path / "full" / "data").mkdir(parents=True)
    (tmp_path / "full" / "precious.txt").write_text("keep me")
    (tmp_path / "full" / "data" / "metadata.json").write_text("{}")
    for name in ("folder.toml", "folder.npz"):
        (tmp_path / name).mkdir()
    for name in ("fifo", "pipe.toml", "pipe.npz"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "zeros.toml").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file.json").write_text("[1, 2")
    (tmp_path / "broken.toml").write_bytes(b"\xff\xfe = [")
    for name in ("broken.npz", "bad.zip"):
        (tmp_path / name).write_bytes(b"PK\x03\x04" + b"\0" * 60)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, str]:
    """Return a digest of every file in a folder, and where links lead."""
    found: dict[str, str] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            found[str(path)] = str(path.readlink())
        elif path.is_file():
            found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


class Hangs(BaseException):
    """Say that a wrong argument keeps a command busy."""


def too_long(*_: object) -> None:
    raise Hangs


def check(chosen: list[Case], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Run commands; none may fail otherwise than in short lines, hang, or change a file."""
    all_programs, before = programs(), contents(folder)
    previous = signal.signal(signal.SIGALRM, too_long)
    faults = []
    for name, argv in chosen:
        shown = f"{name} {' '.join(argv)}"[:300]
        program = all_programs[name]
        signal.alarm(60)
        try:
            code = run(program.function, program.name, argv)
        except SystemExit as stopped:
            code = stopped.code
        except (Exception, Hangs) as error:
            code = f"{type(error).__name__}: {error}"[:300]
        finally:
            signal.alarm(0)
        said = capsys.readouterr().err
        if (
            code not in (0, 1, 2)
            or "Traceback" in said
            or "Not foreseen" in said
            or len(said) > 4_000
            or not (said or not code)
        ):
            faults.append((shown, code, said[:300]))
        after = contents(folder)
        if any(after.get(file) != was for file, was in before.items()):
            faults.append((shown, "changed", [f for f in before if after.get(f) != before[f]]))
        before |= after
    signal.signal(signal.SIGALRM, previous)
    assert not faults, "\n".join(map(str, faults))


def test_wrong_arguments_end_in_one_line(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    light = [case for case in cases() if case[0] not in ("bench", "doctor", "parity", "demo")]
    check(random.Random(0).sample(light, 40), place, capsys)


@pytest.mark.slow
def test_hundreds_of_wrong_arguments_end_in_one_line(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    everything = list(cases())
    assert len(everything) >= 600
    check(everything, place, capsys)
