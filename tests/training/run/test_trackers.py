"""A run logs the same numbers to a tracker as into its own table, and sends nothing."""

from __future__ import annotations

import dataclasses
import json
import socket
import sqlite3
import sys
from pathlib import Path

import pytest

from tests.support.tiny import FRAME_SKIP, tiny_changes
from training.run.metrics import read_metrics
from training.run.train_options import Train
from training.run.trainer import train


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Train:
    """Return a short run; what connects to another machine fails."""
    connect = socket.socket.connect

    def only_here(self: socket.socket, address: object) -> None:
        host = address[0] if isinstance(address, tuple) else "localhost"
        assert host in ("localhost", "127.0.0.1", "::1"), address
        connect(self, address)  # type: ignore[arg-type]

    monkeypatch.setattr(socket.socket, "connect", only_here)
    return Train(
        out=tmp_path / "run",
        algorithm="td3",
        num_demonstrations=1,
        frame_skip=FRAME_SKIP,
        updates=40,
        evaluate_every=20,
        evaluate_episodes=2,
        changes=tiny_changes(),
    )


def test_wandb_has_the_rows_of_the_table(run: Train) -> None:
    pytest.importorskip("wandb")
    train(dataclasses.replace(run, track="wandb"))
    (file,) = run.out.glob("wandb/offline-run-*/*.wandb")
    logged, rows = file.read_bytes(), read_metrics(run.out / "metrics.csv")
    assert [row["update"] for row in rows] == [20, 40]
    for row in rows:  # the file holds each number as text
        for name in ("updates_per_second", "minutes"):
            assert name.encode() in logged
            assert repr(row[name]).encode() in logged


def test_trackio_has_the_rows_of_the_table(
    run: Train, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    pytest.importorskip("trackio")
    train(dataclasses.replace(run, track="trackio"))
    (file,) = (tmp_path / "trackio").glob("*.db")
    with sqlite3.connect(file) as table:
        found = table.execute("SELECT step, metrics FROM metrics ORDER BY step").fetchall()
    rows = read_metrics(run.out / "metrics.csv")
    assert [step for step, _ in found] == [20, 40]
    logged = [json.loads(text)["environment_steps"] for _, text in found]
    assert logged == [row["environment_steps"] for row in rows]


def test_a_tracker_that_is_not_installed_is_told_before_anything_is_trained(
    run: Train, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ModuleNotFoundError, match="wandb"):
        train(dataclasses.replace(run, track="wandb"))
    assert not run.out.exists()
