"""Files are complete or absent, and what is no ordinary file stays what it is."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.files import (
    finish_together,
    refuse_unwritable,
    write_bytes,
    write_json,
    write_text,
    write_together,
)
from cdcsr.leftovers import sweep, temporary_beside
from tests.support.forked import Fault, forked
from tests.support.paths import names


def test_a_file_is_written_and_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    write_text(path, "one µ")
    write_text(path, "two µ")
    assert path.read_text("utf-8") == "two µ"
    assert names(path.parent) == ["a.txt"]


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, b"old")

    def full_disk(self: Path, data: bytes) -> None:
        with self.open("wb") as file:
            file.write(data[:1])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(CdcsrError) as caught:
        write_bytes(path, b"new")
    assert str(caught.value) == f"Cannot write {path}: No space left on device."
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_json_takes_numpy(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"array": np.arange(3), "scalar": np.float32(0.5), "text": "µ"})
    assert json.loads(path.read_text("utf-8")) == {"array": [0, 1, 2], "scalar": 0.5, "text": "µ"}


def test_json_refuses_what_it_cannot_express(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", float("nan"))
    with pytest.raises(TypeError, match="object has no place in JSON"):
        write_json(tmp_path / "a.json", {"a path": object()})
    assert names(tmp_path) == []


@pytest.mark.parametrize("size", [3, 100_000])
def test_a_pipe_is_written_into_and_stays_one(tmp_path: Path, size: int) -> None:
    pipe, data = tmp_path / "pipe", bytes(size)
    os.mkfifo(pipe)
    refuse_unwritable(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_bytes(pipe, data)
    reader.join()
    assert read == [data]
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    assert names(tmp_path) == ["pipe"]


def test_a_device_stays_a_device_and_a_full_one_is_one_line() -> None:
    refuse_unwritable(Path(os.devnull))
    write_text(Path(os.devnull), "nothing")
    assert Path(os.devnull).is_char_device()
    with pytest.raises(CdcsrError, match=r"^Cannot write /dev/full: No space left on device\.$"):
        write_text(Path("/dev/full"), "nothing")


def test_standard_output_is_written_after_what_was_printed(tmp_path: Path) -> None:
    code = "from pathlib import Path; from cdcsr.files import write_text; "
    code += "print('one'); write_text(Path('/dev/stdout'), 'two\\n'); print('three')"
    with (tmp_path / "out").open("wb") as out:
        subprocess.run([sys.executable, "-c", code], check=True, stdout=out)
    assert (tmp_path / "out").read_text() == "one\ntwo\nthree\n"


def test_a_link_is_followed_and_a_mode_is_kept(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    real, link, dangling = tmp_path / "far" / "a", tmp_path / "link", tmp_path / "dangling"
    write_text(real, "old")
    real.chmod(0o640)
    link.symlink_to(real)
    dangling.symlink_to(tmp_path / "far" / "b")
    for path in (link, dangling):
        refuse_unwritable(path)
        write_text(path, "new")
        assert path.is_symlink()
    assert (real.read_text(), (tmp_path / "far" / "b").read_text()) == ("new", "new")
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    assert names(tmp_path / "far") == ["a", "b"]


def test_a_protected_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    write_text(path, "old")
    # A test that runs as root has every permission.
    monkeypatch.setattr(os, "access", lambda which, mode: (which, mode) != (path, os.W_OK))
    for write in (refuse_unwritable, lambda where: write_text(where, "new")):
        with pytest.raises(CdcsrError, match="is protected against writing"):
            write(path)
    assert path.read_text() == "old"


@pytest.mark.parametrize("kind", ["long", "circle", "under a file"])
def test_a_path_that_cannot_be_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    (tmp_path / "file").touch()
    bad = {"long": "x" * 256, "circle": "circle", "under a file": "file/x/y"}[kind]
    for write in (refuse_unwritable, lambda where: write_text(where, "new")):
        with pytest.raises(CdcsrError, match=r"^Cannot write "):
            write(tmp_path / bad)
    assert names(tmp_path) == ["circle", "file"]


def test_what_dead_processes_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    alive, dead = temporary_beside(tmp_path / "a"), temporary_beside(tmp_path / "a")
    reused = dead.with_name(dead.name.replace(f"-{os.getpid()}-", f"-{os.getpid()}-1"))
    dead = dead.with_name(dead.name.replace(f"-{os.getpid()}-", f"-{2**22 + 1}-"))
    machine = dead.name.split("-")[1]
    elsewhere = dead.with_name(dead.name.replace(machine, "0" * 8))
    for path in (alive, elsewhere, tmp_path / ".cdcsr-notes"):
        path.touch()
    for path in (dead, reused):
        path.mkdir()
        (path / "part").touch()
    sweep(tmp_path)
    assert names(tmp_path) == sorted([alive.name, elsewhere.name, ".cdcsr-notes"])
    sweep(tmp_path / "no folder")


def test_files_that_belong_together_are_all_new_or_all_old_whenever_they_are_killed(
    tmp_path: Path,
) -> None:
    old = {"a": b"old a", "b": b"old b", "gone": b"old"}
    new = {"a": b"new a", "b": b"new b", "gone": None, "c": b"new c"}
    folder, number, found = tmp_path / "place", 0, Counter[bool]()
    while True:
        number += 1
        shutil.rmtree(folder, ignore_errors=True)
        write_together(folder, old)
        (folder / "b").chmod(0o640)
        fault = Fault("kill", number)
        outcome = forked(lambda: write_together(folder, new), folder, fault)
        finish_together(folder)
        there = {path.name: path.read_bytes() for path in folder.glob("[a-z]*")}
        whole = there == {"a": b"new a", "b": b"new b", "c": b"new c"}
        assert whole or there == old, (number, there)
        assert stat.S_IMODE((folder / "b").stat().st_mode) == 0o640
        found[whole] += 1
        if outcome.code == 0:
            break
        assert outcome.code == -9
    assert found[False] >= 10  # before the folder with the new files has its name
    assert found[True] >= 8  # four places, the mark of the one that goes, the folder, and the end
    write_together(folder, {"a": b"newest"})
    assert names(folder) == ["a", "b", "c"]
