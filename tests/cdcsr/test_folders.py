"""Folders are complete or absent, and other people's folders are never overwritten."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cdcsr import folders
from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json
from cdcsr.folders import WorkingFolder, new_folder
from cdcsr.locks import Busy
from tests.support.paths import DEAD, names


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
    assert read_json(folder / "record.json") == identity
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
    assert read_json(tmp_path / "record.json") == {"rounds": 4}


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
        assert read_json(tmp_path / "record.json") == {}
        write_json(tmp_path / "record.json", {"done": 1})
    with kind.claim(tmp_path):
        assert read_json(tmp_path / "record.json") == {"done": 1}


def test_of_two_that_make_a_folder_one_is_refused_at_the_start(tmp_path: Path) -> None:
    with new_folder(tmp_path / "out", "models", force=False) as folder:
        (folder / "first").touch()
        with (
            pytest.raises(CdcsrError, match="Another process is making") as caught,
            new_folder(tmp_path / "out", "models", force=True),
        ):
            pytest.fail("the block must not run")
        assert caught.value.exit_code == 2
    assert names(tmp_path / "out") == [".cdcsr", "first"]
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("content", [(), ("thesis.tex",)])
def test_a_folder_that_appears_meanwhile_is_kept_and_so_is_the_work(
    tmp_path: Path, content: tuple[str, ...], force: bool
) -> None:
    place = tmp_path / "out"

    def make() -> None:
        with new_folder(place, "models", force=force) as folder:
            (folder / "work").touch()
            place.mkdir()
            for name in content:
                (place / name).touch()

    if force and not content:  # an empty folder may be replaced
        make()
        assert names(place) == [".cdcsr", "work"]
        return
    (tmp_path / "out-2").touch()  # taken, too
    with pytest.raises(CdcsrError, match=r"appeared while .* its own folder is .*/out-3 now"):
        make()
    assert names(place) == list(content)
    assert names(tmp_path / "out-3") == [".cdcsr", "work"]
    assert names(tmp_path) == ["out", "out-2", "out-3"]


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    with (
        pytest.raises(CdcsrError, match="appeared while"),
        new_folder(tmp_path / "out", "models", force=True),
    ):
        (tmp_path / "out").write_text("precious")
    assert (tmp_path / "out").read_text() == "precious"


@pytest.mark.parametrize("moment", ["before", "between", "after"])
def test_a_process_killed_while_it_replaces_a_folder_loses_neither(
    tmp_path: Path, moment: str
) -> None:
    place, old = make_folder(tmp_path / "out"), tmp_path / ".out.replaced"
    if moment != "before":
        place.rename(old)
    if moment == "between":
        place.mkdir()
    if moment == "after":
        make_folder(tmp_path / "new").rename(place)
        (place / "old").rename(place / "new")
    (tmp_path / ".out.lock").write_text(DEAD)
    with pytest.raises(CdcsrError, match="already exists"), new_folder(place, "models", False):
        pytest.fail("the block must not run")
    assert names(place) == [".cdcsr", "new" if moment == "after" else "old"]
    with new_folder(tmp_path / "next", "models", force=False):
        pass
    assert names(tmp_path) == ["next", "out"]


def test_a_full_disk_leaves_no_folder_and_no_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = make_folder(tmp_path / "out")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    for name in ("write_text", "write_bytes", "mkdir", "rename"):
        with monkeypatch.context() as patch:
            patch.setattr(Path, name, full)
            with (
                pytest.raises(CdcsrError, match=r"^Cannot write .*No space left on device"),
                new_folder(place, "models", force=True) as folder,
            ):
                (folder / "new").write_bytes(b"new")
        assert names(place) == [".cdcsr", "old"]
        assert names(tmp_path) == ["out"]


def test_a_claim_sweeps_what_dead_processes_left(tmp_path: Path) -> None:
    with WORK.claim(tmp_path, {"rounds": 3}):
        (tmp_path / "sub").mkdir()
    for folder in (tmp_path, tmp_path / "sub"):
        left = folders.temporary_beside(folder / "a").name
        (folder / left.replace(f"-{os.getpid()}-", f"-{2**22 + 1}-")).touch()
    (tmp_path / ".lock").write_text(DEAD)
    with WORK.claim(tmp_path, {"rounds": 3}):
        assert names(tmp_path) == [".lock", "record.json", "sub"]
        assert names(tmp_path / "sub") == []
