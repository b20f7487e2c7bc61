"""`cdcsr search`: what it asks for, what it says, how it goes on, and what it refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cdcsr import cli
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.tables import csv_text, read_csv_rows
from cdcsr.tasks.spaces import make_space
from controllers.controller import Controller
from controllers.search import Outcome
from training.commands import search as search_command
from training.config.seeds import TEST_SEED

FOUND = [
    (Outcome(0.25, 200.0, 0.01), Outcome(0.75, 150.0, 0.005)),
    (Outcome(0.0, 250.0, 0.2), Outcome(0.0, 250.0, 0.1)),
    (Outcome(0.0, 250.0, 0.08), Outcome(0.5, 200.0, 0.02)),
    (Outcome(1.0, 100.0, 0.02), Outcome(1.0, 100.0, 0.02)),
]


@pytest.mark.parametrize("missed", [True, False])
def test_each_held_out_target_is_searched_by_itself(
    missed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[np.ndarray, int, int]] = []
    wishes: list[Callable[[Outcome], bool]] = []

    def improve(
        _: Controller,
        env: TaskVectorEnv,
        target: np.ndarray,
        rounds: int,
        seed: int,
        wanted: Callable[[Outcome], bool],
    ) -> tuple[Outcome, Outcome]:
        assert env.num_envs == 48
        asked.append((target.copy(), rounds, seed))
        wishes.append(wanted)
        return FOUND[len(asked) - 1]

    monkeypatch.setattr("controllers.search.improve", improve)
    arguments = [
        "search",
        "jacobian",
        "--robot",
        "planar-single",
        "--out",
        str(tmp_path / "out"),
        "--episodes",
        "4",
        "--rounds",
        "9",
        "--json",
        str(tmp_path / "summary.json"),
    ]
    assert cli.main([*arguments, *(["--missed"] if missed else [])]) == 0
    targets = make_space("anchor", load_robot("planar-single")).sample(
        np.random.default_rng(TEST_SEED), 4
    )
    np.testing.assert_array_equal([target for target, _, _ in asked], targets)
    assert {rounds for _, rounds, _ in asked} == {9}
    assert len({seed for _, _, seed in asked}) == 4  # plans and disturbances of their own
    for wanted in wishes:
        assert [wanted(Outcome(reached, 100, 0.02)) for reached in (0.0, 0.49, 0.5, 1.0)] == (
            [True, True, False, False] if missed else [True] * 4
        )
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert (summary["reached"], summary["length"]) == (0.3125, 200.0)
    assert (summary["best_reached"], summary["best_length"]) == (0.5625, 175.0)
    assert (summary["never"], summary["most_steps"]) == ([1], 250)


def test_the_command_goes_on_and_refuses_another_search(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search_command, "_COPIES", 6)

    def search(out: Path, episodes: int, *more: str) -> int:
        asked = [
            "search",
            "batd3-spatter-mujoco",
            "--out",
            str(out),
            "--space",
            "anchor",
            "--rounds",
            "1",
        ]
        return cli.main(
            [*asked, "--episodes", str(episodes), "--json", str(tmp_path / "summary.json"), *more]
        )

    whole, halted = tmp_path / "whole", tmp_path / "halted"
    assert search(whole, 2) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["reached"] == 1
    assert summary["best_length"] <= summary["length"]
    shutil.copytree(whole, halted)
    head, (first, second) = read_csv_rows(halted / "targets.csv")
    kept = [*first[:5], "12.5", *first[6:]]  # what is there already is not made again
    (halted / "targets.csv").write_text(csv_text(head, [kept]))  # stopped after the first target
    assert search(halted, 2) == 0
    assert read_csv_rows(halted / "targets.csv") == (head, [kept, second])
    assert search(whole, 2) == 0  # nothing is left to do
    assert json.loads((tmp_path / "summary.json").read_text()) == summary

    capsys.readouterr()
    assert search(whole, 2, "--missed") == 2
    assert "holds a search with other options (missed)" in capsys.readouterr().err
    assert search(whole, 1) == 2
    assert "holds a search with other options (episodes)" in capsys.readouterr().err
    (whole / "targets.csv").write_text(csv_text(head, [second]))
    assert search(whole, 2) == 2
    assert "is of other targets: line 2 is of target 1 at (" in capsys.readouterr().err
    (whole / "targets.csv").write_text("episode,x\n0,north\n")
    assert search(whole, 2) == 2
    assert "damaged" in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "targets.csv").write_text("precious")
    for force in ((), ("--force",)):
        assert search(tmp_path / "other", 2, *force) == 2
    assert (tmp_path / "other" / "targets.csv").read_text() == "precious"
    assert "exists and is not a search" in capsys.readouterr().err
    assert search(whole / "search.json" / "below", 2) == 2
    assert "Cannot write" in capsys.readouterr().err
    assert search(tmp_path / "none", 0) == 2
    assert "episodes must be a whole number from 1 to 100000" in capsys.readouterr().err
