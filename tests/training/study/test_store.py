"""The store of results: what is packed is read back, and damage is named."""

from __future__ import annotations

import errno
import itertools
import json
import shutil
from hashlib import sha256
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from cdcsr.errors import CdcsrError
from tests.support.forked import Fault, forked
from tests.support.small_study import HEAD, nominal, write_csv, write_run
from training.study.parquet import SUMS, read_table, table_bytes
from training.study.store import pack, read_results, write_store

FOLLOW = ("backend", "motion", "episode", "step", "tip_error")
FOLLOW += ("base_position_error", "base_attitude_error")


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """A working folder: two runs, a search and a sweep."""
    work = tmp_path / "work"
    first = write_run(work, "one", {"nominal": [nominal("10")]}, [(500, 0.25), (1000, 0.5)])
    write_csv(first / "follow.csv", FOLLOW, [["mujoco", "line", 0, 25, 0.18567, 0.00003, 0.00056]])
    second = write_run(work, "two", {"nominal": [nominal("111")]})
    rows = [["mujoco", "anchor", "nominal", 0.5, i, 1, 300 - i, 0.02934] for i in range(3)]
    write_csv(second / "workspace.csv", HEAD, rows)
    search = work / "spatter"
    search.mkdir()
    (search / "search.json").write_text(json.dumps({"controller": "c", "rounds": 3}))
    write_csv(search / "targets.csv", ["episode", "x", "reached"], [[0, 0.1234, 0.5]])
    write_csv(work / "policy.csv", HEAD, rows)
    return work


def test_what_is_packed_is_what_was_measured(work: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    assert pack(work, store) == 2
    before, after = read_results(work), read_results(store)
    assert [*after] == ["one", "two"]
    for name, run in after.items():
        assert run.record == before[name].record
        assert run.evaluations.keys() == before[name].evaluations.keys()
        for one, columns in run.evaluations.items():
            for column, values in before[name].evaluations[one].items():
                np.testing.assert_array_equal(columns[column], values)
    assert after["one"].metrics["success_rate"].tolist() == [0.25, 0.5]
    follow = after["one"].follow
    assert follow is not None
    sample = ["mujoco", "line", 0, 25, 0.18567, 0.00003, 0.00056]
    assert [follow[name].tolist()[0] for name in FOLLOW] == sample
    assert after["two"].evaluations["workspace"]["distance"].tolist() == [0.02934] * 3
    assert (after["one"].episodes("nominal"), after["one"].episodes("plants")) == (2, 0)
    assert read_table(store / "searches.parquet")["x"].tolist() == [0.1234]
    assert json.loads((store / "searches.jsonl").read_text())["name"] == "spatter"
    assert read_table(store / "sweeps.parquet")["name"].tolist() == ["policy"] * 3


def test_packing_adds_to_the_same_policy_and_replaces_another(work: Path, tmp_path: Path) -> None:
    store, more = tmp_path / "store", tmp_path / "more"
    pack(work, store)
    folder = write_run(more, "two", {"plants": [nominal("1")]})
    pack(more, store)
    assert [*read_results(store)["two"].evaluations] == ["nominal", "plants", "workspace"]
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**record, "policy": "another"}))
    pack(more, store)
    runs = read_results(store)
    assert [*runs["two"].evaluations] == ["plants"]
    assert [*runs["one"].evaluations] == ["nominal"]
    assert read_table(store / "sweeps.parquet")["name"].tolist() == ["policy"] * 3


def test_equal_numbers_of_learners_are_stored_once(work: Path, tmp_path: Path) -> None:
    small = {"critics": 2, "hidden": [16, 16]}
    write_run(work, "three", {"nominal": [nominal("1")]})
    path = work / "three/run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "learner": {"critics": 5}}))
    store = tmp_path / "store"
    pack(work, store)
    lines = [json.loads(line) for line in (store / "learners.jsonl").read_text().splitlines()]
    assert sorted(line["critics"] for line in lines) == [2, 5]
    learners = {name: run.record["learner"] for name, run in read_results(store).items()}
    assert learners == {"one": small, "two": small, "three": {"critics": 5}}


def test_distances_are_decimal_numbers_of_four_bytes_or_plain_ones(tmp_path: Path) -> None:
    for number, distance in enumerate(([0.029344, -1.5], [12_345.678904, 0.1])):
        path = tmp_path / f"{number}.parquet"
        data = table_bytes([{"distance": np.array(distance)}])
        assert data is not None
        path.write_bytes(data)
        assert read_table(path)["distance"].tolist() == np.round(distance, 5).tolist()
        about = pq.ParquetFile(path).metadata.row_group(0).column(0)
        assert about.physical_type == ("INT32", "DOUBLE")[number]


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("episodes.parquet", b"PAR1 no longer", "episodes.parquet is damaged"),
        ("runs.jsonl", b"{", "runs.jsonl is damaged"),
        ("runs.jsonl", b"[]\n", "a line has no name"),
        ("runs.jsonl", b'{"name": "two"}\n', "lacks the run one"),
        ("learners.jsonl", b"", "learners.jsonl lacks the learner"),
    ],
)
def test_damage_is_one_clear_line(
    work: Path, tmp_path: Path, file: str, content: bytes, message: str
) -> None:
    store = tmp_path / "store"
    pack(work, store)
    (store / file).write_bytes(content)
    with pytest.raises(CdcsrError, match=f"{file} is damaged: it has not its checksum"):
        read_results(store)
    (store / SUMS).unlink()  # as in a store of an older version
    with pytest.raises(CdcsrError, match=message) as error:
        read_results(store)
    assert "\n" not in str(error.value)


def test_the_checksums_are_those_of_the_usual_tool(work: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    pack(work, store)
    files = sorted(path for path in store.iterdir() if path.name != SUMS)
    lines = [f"{sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in files]
    assert (store / SUMS).read_text().splitlines() == lines


def test_packing_is_all_or_nothing(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, written = tmp_path / "store", itertools.count()
    pack(work, store)
    before = {path.name: path.read_bytes() for path in store.iterdir()}
    shutil.rmtree(work / "two")
    plain = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if next(written) == 4:
            raise OSError(errno.ENOSPC, "No space left on device")
        return plain(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(CdcsrError, match=r"Cannot write .*: No space left on device"):
        pack(work, store)
    assert {path.name: path.read_bytes() for path in store.iterdir()} == before


def test_a_kill_leaves_the_old_store_or_the_new_one(work: Path, tmp_path: Path) -> None:
    def read(store: Path) -> tuple[object, ...]:
        """Return the evaluations of each run, which runs were followed, and the searches."""
        runs = read_results(store)
        evaluations = {name: [*run.evaluations] for name, run in runs.items()}
        followed = [name for name, run in runs.items() if run.follow is not None]
        return evaluations, followed, read_table(store / "searches.parquet").keys()

    old, store, other = tmp_path / "old", tmp_path / "store", tmp_path / "other"
    pack(work, old)
    record = write_run(other, "one", {"plants": [nominal("1")]}) / "run.json"
    record.write_text(json.dumps({**json.loads(record.read_text()), "policy": "another"}))
    shutil.copytree(old, store)
    before, calls = read(store), forked(lambda: pack(other, store), store).calls
    after = read(store)
    assert before[1] == ["one"]
    assert after[1] == []  # following.parquet is deleted: its only run has another policy
    found = set[bool]()
    for number in (calls // 2, calls - 6, calls - 1):  # tests of cdcsr.files do all of them
        shutil.rmtree(store)
        shutil.copytree(old, store)
        outcome = forked(lambda: pack(other, store), store, Fault("kill", number))
        assert outcome.code == -9
        there = read(store)
        assert there in (before, after)
        found.add(there == after)
        assert not (store / ".cdcsr-together").exists()
    assert found == {False, True}


def test_a_missing_column_is_named(work: Path, tmp_path: Path) -> None:
    runs = read_results(work)
    for run in runs.values():
        for columns in run.evaluations.values():
            del columns["length"]
    write_store(tmp_path / "store", runs)
    with pytest.raises(CdcsrError, match="no column length"):
        read_results(tmp_path / "store")
