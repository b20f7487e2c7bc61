"""Broken robot descriptions end in one short line, at once, whatever is wrong with them.

Descriptions are made from the shipped ones by one to four random changes of their text: other
values, keys, lines and letters, and bombs. What is accepted all the same must be a whole robot.
"""

from __future__ import annotations

import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot, parse_robot, shipped_robots

TEXTS = [load_robot(name).to_toml() for name in shipped_robots()]
VALUES = [
    *(
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "-0.0",
        "1e400",
        "1e-320",
        "1e300",
        "1e12",
        "1e-300",
        "true",
    ),
    *("9" * 4_300, "0x" + "f" * 4_000, "9" * 400, "1_000_000_000", "1000000000", "0.5", "3", "2.5"),
    *('""', '"x"', "'nan'", '"' + "long " * 20_000 + '"', '"\\u0000"', '"\\ud800"', '"""a\nb"""'),
    *("[]", "{}", "[[]]", "[1.0, 2.0]", "[nan, nan, nan]", "[1, 2, 3, 4]", '["a", "b", "c"]'),
    *("{ a = 1 }", "[{}, {}]", "[1e9, 1e9, 1e9]", "[1e-9, 1e-9, 1e-9]", "[-1.0, 1.0, 1.0]"),
    *("1979-05-27T07:32:00Z", "07:32:00", "1979-05-27", "=", "[", "}", "", "[" + "0.0, " * 70_000),
    *("[" * 3_000 + "]" * 3_000, "{a=" * 500 + "1" + "}" * 500, "[" + "90.0, " * 5_000 + "]"),
]
BOMBS = [
    "".join(f"key_{n} = {n}\n" for n in range(20_000)),
    "k" * 100_000 + " = 1\n",
    ".".join(["a"] * 3_000) + " = 1\n",
    "[[segments]]\n" * 5_000,
    "[segments.link]\nlength = 1\n" * 50,
    "".join(f"[t{n}.link.cables]\n" for n in range(2_000)),
    "x = " + "[" * 100_000,
    "# " + "comment " * 30_000 + "\n",
]
KEYS = ["lenght", "mass", "", "a.b", '"quoted key"', "ß", "links", "backbone", "k" * 500]
LETTERS = "\0\x07\x1b\ufeff\u202e\U0001f916[]{}=\"'#,.\n9eé"
Change = Callable[[random.Random, str], str]


def other_value(rng: random.Random, text: str) -> str:
    lines = text.splitlines() or [""]
    at = rng.choice([i for i, line in enumerate(lines) if "=" in line] or [0])
    lines[at] = lines[at].partition("=")[0] + "= " + rng.choice(VALUES)
    return "\n".join(lines)


def other_key(rng: random.Random, text: str) -> str:
    lines = text.splitlines()
    at = rng.randrange(len(lines) or 1)
    name = rng.choice(KEYS)
    lines[at : at + 1] = [f"{name} = {lines[at].partition('=')[2] or 1}"] if lines else []
    return "\n".join(lines)


def other_lines(rng: random.Random, text: str) -> str:
    lines = text.splitlines() or [""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(4)
    if what == 0:
        del lines[i]
    elif what == 1:
        lines.insert(j, lines[i])
    elif what == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        del lines[min(i, j) : max(i, j)]
    return "\n".join(lines)


def other_letters(rng: random.Random, text: str) -> str:
    letters = list(text)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(letters) + 1)
        letters[at : at + rng.randrange(3)] = rng.choice(LETTERS)
    return "".join(letters)


def cut(rng: random.Random, text: str) -> str:
    return text[: rng.randrange(len(text) + 1)]


def bomb(rng: random.Random, text: str) -> str:
    what = rng.choice(BOMBS)
    return what + text if rng.random() < 0.5 else f"{text}\n{what}"


CHANGES: list[Change] = [*[other_value] * 6, other_key, other_lines, other_letters, cut]


def broken(rng: random.Random) -> bytes:
    """Return a changed description; one in forty holds a bomb, one in forty no text at all."""
    text = rng.choice(TEXTS)
    for change in rng.choices(CHANGES, k=rng.randrange(1, 5)):
        text = change(rng, text)
    kind = rng.randrange(40)
    if kind == 0:
        text = bomb(rng, text)
    data = text.encode("utf-8", "replace")
    return rng.randbytes(2_000) if kind == 1 else data


def peak_memory() -> float:
    """Return the most memory that this process has had, in bytes."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def error_of(file: Path) -> str | None:
    """Return why a description is refused; check that one that is accepted is whole."""
    try:
        robot = load_robot(file)
    except CdcsrError as error:
        return str(error)
    assert parse_robot(robot.to_toml()) == robot
    return None


def check_many(num: int, file: Path) -> tuple[int, float]:
    """Read descriptions; return how many were refused, and the longest time in [s]."""
    rng, refused, longest, before = random.Random(0), 0, 0.0, peak_memory()
    for _ in range(num):
        file.write_bytes(broken(rng))
        start = time.process_time()
        message = error_of(file)
        longest = max(longest, time.process_time() - start)
        refused += message is not None
        assert message is None or (len(message) < 2_000 and message.isprintable())
    assert longest < 1.0
    assert peak_memory() - before < 5e8
    return refused, longest


def test_broken_descriptions_end_in_one_line(tmp_path: Path) -> None:
    refused, _ = check_many(150, tmp_path / "broken.toml")
    assert refused > 125


@pytest.mark.slow
def test_ten_thousand_broken_descriptions_end_in_one_line(tmp_path: Path) -> None:
    refused, longest = check_many(10_000, tmp_path / "broken.toml")
    print(f"\n{refused} of 10,000 refused, the slowest in {longest:.2f} s")
    assert refused > 8_000


def check_by_command(num: int, folder: Path) -> None:
    """Give broken descriptions to `cdcsr engines`; what its start costs is not counted."""
    rng, file = random.Random(1), folder / "broken.toml"
    alone_time, alone_memory, code, _ = engines(folder / "none.toml")
    assert code == 2
    done = 0
    while done < num:
        file.write_bytes(broken(rng))
        if error_of(file) is None:
            continue
        done += 1
        seconds, memory, code, said = engines(file)
        assert code == 2
        assert said.startswith("cdcsr: error: ")
        assert len(said) < 2_000
        assert said.count("\n") == 1
        assert seconds - alone_time < 1.0
        assert memory - alone_memory < 5e8


def engines(robot: Path) -> tuple[float, float, int, str]:
    """Run `cdcsr engines`; return its processor time in [s], its memory, exit code and errors."""
    command = [sys.executable, "-m", "cdcsr", "engines", "--robot", str(robot)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    assert process.stderr is not None
    said = process.stderr.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    process.stderr.close()
    process.returncode = code = os.waitstatus_to_exitcode(status)
    return used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss, code, said


def test_broken_descriptions_on_the_command_line(tmp_path: Path) -> None:
    check_by_command(3, tmp_path)


@pytest.mark.slow
def test_two_hundred_broken_descriptions_on_the_command_line(tmp_path: Path) -> None:
    check_by_command(200, tmp_path)
