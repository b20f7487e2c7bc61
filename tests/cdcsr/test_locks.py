"""A lock is held by one process, and taken over only from a dead one."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cdcsr import locks
from cdcsr.locks import STALE_AFTER, Busy, lock
from tests.support.tiny import is_held


def test_a_lock_is_held_once_and_given_back(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    with lock(path):
        assert is_held(path)
        with pytest.raises(Busy, match=f"live process {os.getpid()}"), lock(path):
            pass
        assert is_held(path)
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    code = "import sys, time; from pathlib import Path; from cdcsr.locks import lock\n"
    code += "with lock(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    with pytest.raises(Busy), lock(path):
        pass
    process.kill()
    process.stdout.close()
    # Also while it is a zombie: its parent has not asked how it ended.
    deadline = time.monotonic() + 10
    while is_held(path) and time.monotonic() < deadline:
        time.sleep(0.01)
    with lock(path):
        assert is_held(path)
    process.wait()
    assert list(tmp_path.iterdir()) == []


def test_a_holder_on_another_machine_holds_the_lock_as_long_as_it_gives_signs_of_life(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.lock"
    path.write_text(json.dumps({"pid": 1, "host": "elsewhere", "started": None, "token": "x"}))
    with pytest.raises(Busy, match="on elsewhere"), lock(path):
        pass
    before = time.time() - STALE_AFTER - 5
    os.utime(path, (before, before))
    with lock(path):
        assert "elsewhere" not in path.read_text()


@pytest.mark.parametrize("seed", range(5))
def test_a_dead_lock_is_taken_by_one_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Even if time passes between the two steps: seeing that a lock is dead, and replacing it."""
    draw, judge = random.Random(seed), locks._is_stale

    def slowly(path: Path) -> bool:
        stale = judge(path)
        time.sleep(draw.uniform(0, 0.02))
        return stale

    monkeypatch.setattr(locks, "_is_stale", slowly)
    path, holders, most = tmp_path / "run.lock", list[int](), list[int]()
    path.write_text(
        json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "started": "0", "token": "x"})
    )
    start = threading.Barrier(8)

    def take(i: int) -> None:
        start.wait()
        try:
            with lock(path):
                holders.append(i)
                most.append(len(holders))
                time.sleep(0.2)
                holders.remove(i)
        except Busy:
            pass

    threads = [threading.Thread(target=take, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1]
    assert list(tmp_path.iterdir()) == []


def test_a_lock_whose_taker_died_as_well_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    dead = json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "started": "0", "token": "x"})
    path.write_text(dead)
    (tmp_path / ".run.lock.next").write_text(dead)
    with lock(path):
        assert is_held(path)
    assert list(tmp_path.iterdir()) == []
