"""Runs on a device that are stopped, killed or begun anew."""

from __future__ import annotations

import shutil
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from cdcsr.errors import CdcsrError
from cdcsr.locks import Busy, lock
from tests.support.tiny import tiny_device_run
from training.policy import load_policy
from training.run.device_first import share_demonstrations
from training.run.device_run import train_on_device
from training.run.setup import Setup

CPU = torch.device("cpu")


def _weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_file(folder / "policy.safetensors")


class _Clock:
    """A clock that stands still until it has been looked at so many times.

    A run that may take no time looks once an update, and a few times more.
    """

    def __init__(self, calls: int) -> None:
        self.calls = calls

    def monotonic(self) -> float:
        self.calls -= 1
        return float(-min(0, self.calls))


def test_runs_resume_to_the_bit(
    tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options: dict[str, Any] = {"seeds": "0:2", "start": "moving", "randomize": 1.0}
    whole = tiny_device_run(tmp_path / "whole", demonstrations, **options)
    train_on_device(whole, CPU)
    parts = tiny_device_run(tmp_path / "parts", demonstrations, stop_after=0.0, **options)
    # Before any episode has ended, and when copies are in their second or third.
    for calls, least, most in (0, 1, 1), (40, 32, 79):
        monkeypatch.setattr("training.run.device_run.time", _Clock(calls))
        train_on_device(parts, CPU)
        card = load_policy(tmp_path / "parts/s1").card
        assert least <= card["unfinished"]["update"] <= most
        assert (tmp_path / "parts/s1/first.safetensors").exists()
    monkeypatch.undo()
    train_on_device(tiny_device_run(tmp_path / "parts", demonstrations, **options), CPU)
    for run in ("s0", "s1"):
        again = _weights(tmp_path / "parts" / run)
        for name, weights in _weights(tmp_path / "whole" / run).items():
            assert torch.equal(weights, again[name])
    assert {x.name for x in (tmp_path / "parts/s1").iterdir() if not x.name.startswith(".")} == {
        *("clone", "config.json", "metrics.csv", "policy.json", "policy.safetensors"),
        *("summary.json", "tensorboard"),
    }
    train_on_device(whole, CPU)  # a finished run is left alone


def test_what_a_run_began_with_is_read_back(
    tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Engines on a GPU would not repeat it to the bit."""
    options = {"stop_after": 0.0, "evaluate_every": 0}
    first = tiny_device_run(tmp_path / "run", demonstrations, **options)
    train_on_device(first, CPU)
    monkeypatch.setattr(Setup, "first_episodes", lambda *_: pytest.fail("simulated again"))
    monkeypatch.setattr("training.run.device_parts.imitate", lambda *_: pytest.fail("again"))
    train_on_device(first, CPU)
    path = tmp_path / "run/first.safetensors"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(CdcsrError, match=r"first\.safetensors is damaged"):
        train_on_device(first, CPU)


def test_a_run_of_several_can_go_on_alone(tmp_path: Path, demonstrations: Path) -> None:
    both = tiny_device_run(tmp_path / "runs", demonstrations, seeds="0:2", stop_after=0.0)
    train_on_device(both, CPU)
    alone = tiny_device_run(tmp_path / "runs/s0", demonstrations, seed=0)
    train_on_device(replace(alone, stop_after=0.0), CPU)
    # They stand at different updates now, and go on one after the other.
    train_on_device(both, CPU)
    for run, update in ("s0", 3), ("s1", 2):
        card = load_policy(tmp_path / "runs" / run).card
        assert card["unfinished"]["update"] == update
    train_on_device(alone, CPU)
    train_on_device(tiny_device_run(tmp_path / "runs", demonstrations, seeds="0:2"), CPU)
    train_on_device(tiny_device_run(tmp_path / "whole", demonstrations, seeds="0:2"), CPU)
    for name, weights in _weights(tmp_path / "whole/s1").items():
        torch.testing.assert_close(
            weights, _weights(tmp_path / "runs/s1")[name], rtol=1e-3, atol=1e-4
        )


@pytest.mark.parametrize("moved", [0, 1])
def test_a_kill_between_checkpoints_loses_none(
    moved: int, tmp_path: Path, demonstrations: Path
) -> None:
    """Either all runs have the new checkpoint, or all have the one before."""
    stopping = tiny_device_run(tmp_path / "runs", demonstrations, seeds="0:2", stop_after=0.0)
    train_on_device(stopping, CPU)
    state, waiting = "state.safetensors", "state.next.safetensors"
    old = (tmp_path / "runs/s1" / state).read_bytes()
    train_on_device(stopping, CPU)  # two updates
    new = tmp_path / "runs/s1" / state
    if moved:  # s0 was put in place, s1 was not
        new.rename(new.with_name(waiting))
        new.write_bytes(old)
    else:  # s0 was written and waits, s1 was not written
        new.write_bytes(old)
        first = tmp_path / "runs/s0" / state
        shutil.copy(first, first.with_name(waiting))
        first.unlink()
        (tmp_path / "spare").mkdir()
        train_on_device(
            tiny_device_run(tmp_path / "spare", demonstrations, seeds="0:2", stop_after=0.0), CPU
        )
        shutil.copy(tmp_path / "spare/s0" / state, first)
    train_on_device(stopping, CPU)
    done = load_policy(tmp_path / "runs/s1").card["unfinished"]["update"]
    assert done == (3 if moved else 2)
    assert not list((tmp_path / "runs").rglob(waiting))


def test_force_deletes_nothing_while_one_folder_is_busy(
    tmp_path: Path, demonstrations: Path
) -> None:
    options = {"algorithm": "bc", "updates": 0, "seeds": "0:2"}
    train_on_device(tiny_device_run(tmp_path / "runs", demonstrations, **options), CPU)
    summary = tmp_path / "runs/s0/summary.json"
    with lock(tmp_path / "runs/s1/.lock"), pytest.raises(Busy):
        train_on_device(
            tiny_device_run(tmp_path / "runs", demonstrations, force=True, **options), CPU
        )
    assert summary.exists()


def test_demonstrations_that_a_run_recorded_are_read_back(
    tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = tiny_device_run(tmp_path / "run", demonstrations, "td3wd", stop_after=0.0, seeds="0:2")
    first = replace(given, demonstrations=None, num_demonstrations=2)
    train_on_device(first, CPU)
    whole = Setup(first.each_seed()[1]).episodes
    monkeypatch.setattr("controllers.demonstrations.record", lambda *_: pytest.fail("again"))
    train_on_device(first, CPU)
    setup = Setup(first.each_seed()[1])
    share_demonstrations([setup])
    for found, expected in zip(setup.episodes, whole, strict=True):
        for one, other in zip(astuple(found), astuple(expected), strict=True):
            np.testing.assert_array_equal(one, other)


def test_only_the_clones_that_are_missing_are_trained(tmp_path: Path, demonstrations: Path) -> None:
    runs = tmp_path / "runs"
    train_on_device(tiny_device_run(runs, demonstrations, seeds="0:2", stop_after=0.0), CPU)
    old = [_weights(runs / name / "clone") for name in ("s0", "s1")]
    kept = (runs / "s0/clone/policy.safetensors").stat().st_mtime_ns
    shutil.rmtree(runs / "s1/clone")
    for name in "s0", "s1":
        (runs / name / "state.safetensors").unlink()
    first = (runs / "s1/first.safetensors").stat().st_mtime_ns
    train_on_device(tiny_device_run(runs, demonstrations, seeds="0:2", stop_after=0.0), CPU)
    assert (runs / "s0/clone/policy.safetensors").stat().st_mtime_ns == kept
    assert (runs / "s1/first.safetensors").stat().st_mtime_ns > first
    new = [_weights(runs / name / "clone") for name in ("s0", "s1")]
    for before, after in zip(old, new, strict=True):
        for name, weights in before.items():
            torch.testing.assert_close(after[name], weights, rtol=1e-4, atol=1e-5)
