"""Files and folders are complete or absent, and other people's folders are never overwritten."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.files import WorkingFolder, new_folder, write_bytes, write_json, write_text
from cdcsr.locks import Busy


def names(folder: Path) -> list[str]:
    """Return all names in a folder, hidden ones included."""
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


def test_json_refuses_what_it_cannot_express(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", float("nan"))
    with pytest.raises(TypeError, match="object has no place in JSON"):
        write_json(tmp_path / "a.json", {"a path": object()})
    assert names(tmp_path) == []


def test_a_new_folder_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    place = tmp_path / "new" / "out"
    with new_folder(place, "models", force=False) as folder:
        (folder / "a").write_text("a")
        assert not place.exists()
    assert names(place) == [".cdcsr", "a"]
    assert names(place.parent) == ["out"]


def fill_and_fail(place: Path, failure: type[BaseException], force: bool = False) -> None:
    with new_folder(place, "models", force) as folder:
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
    with pytest.raises(CdcsrError) as caught, new_folder(place, "models", force=False):
        pytest.fail("the block must not run")
    assert (
        str(caught.value)
        == f"{place} already exists; give another folder, or --force to replace it."
    )


def make_folder(place: Path, kind: str = "models") -> Path:
    """Make a folder with one file."""
    with new_folder(place, kind, force=False) as folder:
        (folder / "old").write_text("old")
    return place


def test_force_replaces_the_whole_folder(tmp_path: Path) -> None:
    place = make_folder(tmp_path / "out")
    with new_folder(place, "models", force=True) as folder:
        (folder / "new").write_text("new")
        assert names(place) == [".cdcsr", "old"]
    assert names(place) == [".cdcsr", "new"]
    assert names(tmp_path) == ["out"]


def test_force_replaces_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with new_folder(tmp_path / "out", "models", force=True) as folder:
        (folder / "new").write_text("new")
    assert names(tmp_path / "out") == [".cdcsr", "new"]


def test_force_replaces_no_folder_of_another_kind(tmp_path: Path) -> None:
    other = make_folder(tmp_path / "out", "a report")
    with (
        pytest.raises(CdcsrError, match="holds a report, not models, and is not replaced"),
        new_folder(other, "models", force=True),
    ):
        pytest.fail("the block must not run")
    (tmp_path / "mine").mkdir()
    for hidden in (".git", "thesis.tex"):  # hidden files are precious, too
        (tmp_path / "mine" / hidden).write_text("precious")
        with (
            pytest.raises(CdcsrError, match="holds files that this command did not make"),
            new_folder(tmp_path / "mine", "models", force=True),
        ):
            pytest.fail("the block must not run")
    assert names(other) == [".cdcsr", "old"]
    assert names(tmp_path / "mine") == [".git", "thesis.tex"]


def test_a_failure_under_force_keeps_the_old_folder(tmp_path: Path) -> None:
    place = make_folder(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        fill_and_fail(place, KeyboardInterrupt, force=True)
    assert names(place) == [".cdcsr", "old"]
    assert names(tmp_path) == ["out"]


def test_force_replaces_neither_a_file_nor_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(CdcsrError, match="is a file"),
        new_folder(tmp_path / "file", "models", force=True),
    ):
        pytest.fail("the block must not run")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for place in (Path(), tmp_path):
        with (
            pytest.raises(CdcsrError, match="holds the current folder"),
            new_folder(place, "models", force=True),
        ):
            pytest.fail("the block must not run")


WORK = WorkingFolder("a search", "record.json", frozenset({"rounds"}), ("table.csv", "sub/*.bin"))


def test_a_working_folder_is_new_or_resumed_and_locked_meanwhile(tmp_path: Path) -> None:
    folder, identity = tmp_path / "new" / "work", {"rounds": 3, "robot": {"name": "paper"}}
    with WORK.claim(folder, identity):
        assert names(folder) == [".lock", "record.json"]
        (folder / "table.csv").write_text("1")
        with pytest.raises(Busy), WORK.claim(folder, identity):
            pytest.fail("the block must not run")
    assert json.loads((folder / "record.json").read_text()) == identity
    (folder / ".left-by-a-killed-process").touch()
    with WORK.claim(folder, identity):
        assert (folder / "table.csv").read_text() == "1"


def test_other_work_is_refused_by_the_names_of_what_differs(tmp_path: Path) -> None:
    with WORK.claim(tmp_path, {"rounds": 3, "robot": {"name": "paper"}, "seed": 1}):
        (tmp_path / "table.csv").write_text("1")
    asked = {"rounds": 3, "robot": {"name": "other"}, "seed": 2}
    with (
        pytest.raises(CdcsrError, match=r"a search with other options \(robot\.name, seed\)"),
        WORK.claim(tmp_path, asked),
    ):
        pytest.fail("the block must not run")
    assert (tmp_path / "table.csv").read_text() == "1"


def test_an_older_record_is_translated_before_it_is_compared(tmp_path: Path) -> None:
    def older(record: dict[str, object]) -> dict[str, object]:
        return {"seed": 1, **record}

    with WORK.claim(tmp_path, {"rounds": 3}):
        pass
    WORK.check(tmp_path, {"rounds": 3, "seed": 1}, older=older)
    with pytest.raises(CdcsrError, match=r"other options \(seed\)"):
        WORK.check(tmp_path, {"rounds": 3, "seed": 2}, older=older)


def test_force_begins_anew_and_deletes_only_results(tmp_path: Path) -> None:
    with WORK.claim(tmp_path, {"rounds": 3}):
        (tmp_path / "sub").mkdir()
        for name in ("table.csv", "sub/a.bin", "sub/notes", "notes"):
            (tmp_path / name).touch()
    with WORK.claim(tmp_path, {"rounds": 4}, force=True):
        assert names(tmp_path) == [".lock", "notes", "record.json", "sub"]
        assert names(tmp_path / "sub") == ["notes"]
    assert json.loads((tmp_path / "record.json").read_text()) == {"rounds": 4}


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("record", [None, "{}", "[]", "{"])
def test_a_folder_of_something_else_is_never_claimed(
    tmp_path: Path, record: str | None, force: bool
) -> None:
    (tmp_path / "table.csv").write_text("precious")
    if record is not None:
        (tmp_path / "record.json").write_text(record)
    before = names(tmp_path)
    with (
        pytest.raises(CdcsrError, match=r"is not a search|cannot be read"),
        WORK.claim(tmp_path, {"rounds": 3}, force=force),
    ):
        pytest.fail("the block must not run")
    assert names(tmp_path) == before
    with (
        pytest.raises(CdcsrError, match="is not a search"),
        WORK.claim(tmp_path / "table.csv", {"rounds": 3}, force=force),
    ):
        pytest.fail("the block must not run")


def test_work_without_an_identity_is_resumed_as_it_is(tmp_path: Path) -> None:
    kind = WorkingFolder("a demo", "record.json")
    with kind.claim(tmp_path):
        assert json.loads((tmp_path / "record.json").read_text()) == {}
        write_json(tmp_path / "record.json", {"done": 1})
    with kind.claim(tmp_path):
        assert json.loads((tmp_path / "record.json").read_text()) == {"done": 1}
