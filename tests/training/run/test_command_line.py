"""A training run read from a command line, and how it is carried out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from training.algorithms.registry import ALGORITHMS, Algorithm, find_algorithm, own_numbers
from training.algorithms.td3 import TD3, TD3Numbers
from training.run.command_line import read_train
from training.run.train_options import Train, read_older

OUT = ["--out", "x"]
PAPER = load_robot("paper")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"clone_anchor": -3.0}, "clone_anchor: should be greater than or equal to 0; found -3"),
        ({"target_critics": 3}, r"target_critics must be at most critics \(2\); found 3"),
        ({"batch_size": 0}, "batch_size: should be greater than or equal to 1"),
        ({"discount": 1.5}, "discount: should be less than or equal to 1"),
        ({"learning_rate": -1.0}, "learning_rate: should be greater than 0"),
        ({"practice": float("nan")}, "practice: should be a finite number"),
        ({"learning_rate": float("inf")}, "learning_rate: should be a finite number"),
        ({"soft_update": -3.0}, "soft_update: should be greater than 0"),
        ({"hidden": ()}, "hidden: .*at least 1"),
        ({"hidden": (30_000,)}, "hidden: should be less than or equal to 16384"),
        ({"hidden": (8,) * 17}, "hidden: .*at most 16 items"),
        ({"capacity": 10**23}, "capacity: should be less than or equal to 1000000000"),
        ({"num_envs": 10**6}, "num_envs: should be less than or equal to 100000"),
        ({"hidden": (16, 0)}, "hidden: should be greater than or equal to 1"),
        ({"step_cost": 0.1}, "Unknown option of this algorithm 'step_cost'"),
    ],
)
def test_impossible_numbers_are_refused(numbers: dict[str, object], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        _ = Train(out=Path("x"), changes=tuple(numbers.items())).learner


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"evaluate_every": -7}, "evaluate_every must be a whole number from 0"),
        ({"evaluate_episodes": 0}, "evaluate_episodes must be a whole number from 1 to 100000"),
        ({"num_demonstrations": 0}, "num_demonstrations must be a whole number from 1"),
        ({"stop_after": float("nan")}, "stop_after must be a number from 0 to"),
    ],
)
def test_impossible_options_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        Train(out=Path("x"), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("algorithm", ["clasp", "batd3", "bc"])
@pytest.mark.parametrize("flag", ["symmetry", "no-symmetry"])
def test_a_switch_can_be_given_both_ways(algorithm: str, flag: str) -> None:
    run = read_train("training", [*OUT, "--algorithm", algorithm, f"--learner.{flag}"])
    assert run.learner.symmetry == (flag == "symmetry")


def test_the_last_of_repeated_options_counts_and_the_preset_gives_the_rest() -> None:
    both = ["--algorithm", "td3", "--preset=paper-reading", "--algorithm", "clasp"]
    run = read_train("training", [*OUT, *both, "--preset=tuned", "--learner.updates", "7"])
    assert (run.algorithm, run.preset, run.updates, run.changes) == ("clasp", "tuned", 7, ())
    run = read_train("training", [*OUT, "--preset", "paper-reading", "--learner.critics", "3"])
    assert run.changes == (("critics", 3),)
    assert run.learner == own_numbers("batd3", "paper-reading").changed(critics=3)


def test_numbers_for_a_task() -> None:
    for task, discount in (("capture-drift", 0.997), ("reach", 0.99)):
        run = read_train("training", [*OUT, "--task", task, "--algorithm", "clasp"])
        assert run.learner.model_dump()["discount"] == discount
    numbers = own_numbers("clasp", "tuned", "follow-line").model_dump()
    assert numbers["anchor_floor"] == 0.7
    assert own_numbers("clasp", "paper-reading", "capture").model_dump()["discount"] == 0.99


def test_an_option_that_the_algorithm_does_not_read_does_not_exist(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stop:
        read_train("training", [*OUT, "--algorithm", "bc", "--learner.num-envs", "4"])
    assert stop.value.code == 2
    assert "--learner.num-envs" in capsys.readouterr().err


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_help_is_one_screen_and_names_what_the_algorithm_reads(
    algorithm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        read_train("training", ["--algorithm", algorithm, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert len(text.splitlines()) < 40
    assert all(len(line) <= 100 for line in text.splitlines())
    words = text.replace(",", " ").split()
    assert set(find_algorithm(algorithm).numbers.model_fields) <= set(words)
    assert ("softmax_temperature" in words) == (
        algorithm in ("batd3", "batd3-no-prefill", "batd3-no-ensemble")
    )


def test_a_new_algorithm_needs_only_its_place_in_the_list(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(ALGORITHMS, "toy", Algorithm("Toy", "#000000", TD3Numbers, TD3))
    run = read_train("training", [*OUT, "--algorithm", "toy", "--learner.num-envs", "3"])
    assert run.learner == own_numbers("toy", "tuned").changed(num_envs=3)
    with pytest.raises(SystemExit):
        read_train("training", ["--help"])
    assert "toy" in capsys.readouterr().out


def test_a_policy_is_named_for_the_changes_it_depends_on() -> None:
    changes = (("hidden", (64, 64)), ("practice", 0.3), ("symmetry", True))
    run = Train(out=Path("x"), algorithm="clasp", seed=3, updates=5, changes=changes)
    names = [run.policy_name(name, run.changes_of(name)) for name in ("clasp", "bc")]
    assert names == [
        "clasp-tuned-anchor-mujoco-s3-hidden=64x64-practice=0.3-symmetry=true",
        "bc-tuned-anchor-mujoco-s3-hidden=64x64-symmetry=true",
    ]
    run = Train(out=Path("x"), algorithm="clasp", task="capture")
    assert run.policy_name("clasp", ()) == "clasp-tuned-capture-anchor-mujoco-s0"
    run = Train(out=Path("x"), algorithm="clasp", task="capture", start="anywhere")
    assert run.policy_name("clasp", ()) == "clasp-tuned-capture-anchor-anywhere-mujoco-s0"


def test_the_record_of_an_older_version_is_translated() -> None:
    run = Train(out=Path("x"), algorithm="td3", updates=9)
    now = run.identity(PAPER)
    learner = dict(now["learner"])  # type: ignore[call-overload]
    retired = {"step_cost": 0.0, "target_choice": "softmax", "final_learning_rate": 1.0}
    older = {**now, "learner": {**learner, **retired, "softmax_temperature": 10.0}}
    del older["learner"]["hindsight"]  # type: ignore[attr-defined]
    assert read_older(older, run, now, Path("config.json")) == now
    paper = Train(out=Path("x"), algorithm="td3", preset="paper-reading")
    older = {**paper.identity(PAPER), "preset": "paper"}
    assert read_older(older, paper, {}, Path("config.json")) == paper.identity(PAPER)
    assert "start" not in paper.identity(PAPER)  # so that older runs can be resumed
    moving = replace(paper, start="moving")
    assert moving.identity(PAPER)["start"] == "moving"
    now = moving.identity(PAPER)
    assert read_older(now, moving, now, Path("config.json")) == now
    mapped = {**now, "map": "0123456789abcdef"}  # of a map of the user's own
    assert read_older(now, moving, mapped, Path("config.json")) == mapped
    changed = {**now, "map": "another"}
    assert read_older(changed, moving, mapped, Path("config.json")) == changed
    older["learner"] = {**learner, "step_cost": 0.004}
    with pytest.raises(CdcsrError, match=r"a run with step_cost = 0\.004, an option that this"):
        read_older(older, run, now, Path("config.json"))
