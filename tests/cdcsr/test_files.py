"""Outputs are complete or absent."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.files import new_folder, write_bytes, write_json, write_text


def names(folder: Path) -> list[str]:
    """Everything in a folder, temporary names included."""
    return sorted(path.name for path in folder.iterdir())


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


def test_json_refuses_what_it_cannot_say(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", float("nan"))
    with pytest.raises(TypeError, match="object has no place in JSON"):
        write_json(tmp_path / "a.json", {"a path": object()})
    assert names(tmp_path) == []


def test_a_new_folder_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    place = tmp_path / "new" / "out"
    with new_folder(place, force=False) as folder:
        (folder / "a").write_text("a")
        assert not place.exists()
    assert names(place) == ["a"]
    assert names(place.parent) == ["out"]


def fill_and_fail(place: Path, failure: type[BaseException], force: bool = False) -> None:
    with new_folder(place, force) as folder:
        (folder / "new").write_text("new")
        raise failure


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_a_failure_leaves_nothing(tmp_path: Path, failure: type[BaseException]) -> None:
    with pytest.raises(failure):
        fill_and_fail(tmp_path / "out", failure)
    assert names(tmp_path) == []


def test_an_existing_folder_is_refused_with_the_remedy(tmp_path: Path) -> None:
    place = tmp_path / "out"
    place.mkdir()
    with pytest.raises(CdcsrError) as caught, new_folder(place, force=False):
        pytest.fail("the block must not run")
    assert (
        str(caught.value)
        == f"{place} already exists; give another folder, or --force to replace it."
    )


def test_force_replaces_the_whole_folder(tmp_path: Path) -> None:
    place = tmp_path / "out"
    place.mkdir()
    (place / "old").write_text("old")
    with new_folder(place, force=True) as folder:
        (folder / "new").write_text("new")
        assert names(place) == ["old"]
    assert names(place) == ["new"]
    assert names(tmp_path) == ["out"]


def test_a_failure_under_force_keeps_the_old_folder(tmp_path: Path) -> None:
    place = tmp_path / "out"
    place.mkdir()
    (place / "old").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        fill_and_fail(place, KeyboardInterrupt, force=True)
    assert names(place) == ["old"]
    assert names(tmp_path) == ["out"]


def test_force_replaces_neither_a_file_nor_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CdcsrError, match="is a file"), new_folder(tmp_path / "file", force=True):
        pytest.fail("the block must not run")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for place in (Path(), tmp_path):
        with (
            pytest.raises(CdcsrError, match="holds the current folder"),
            new_folder(place, force=True),
        ):
            pytest.fail("the block must not run")
