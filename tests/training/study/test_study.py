"""The study: its grid, its evaluations, and what of a job is still to be done."""

from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from cdcsr.cli import run
from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json
from cdcsr.leftovers import temporary_beside
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names
from controllers.jacobian import JacobianController
from tests.support.tiny import TINY_BUDGET, tiny_job
from training.algorithms.registry import numbers_of
from training.config.run_description import SCRIPTED, RunDescription
from training.experiments import experiments
from training.measure.following import follow
from training.study.declare.budgets import BUDGETS
from training.study.declare.grid import EXPERIMENTS, collect
from training.study.execute import evaluations, jobs
from training.study.execute.evaluations import EPISODE_COLUMNS, EVALUATIONS, Evaluation
from training.study.execute.jobs import Job

# -- evaluations


def test_the_demonstrator_follows_what_moves() -> None:
    robot = load_robot("paper")
    samples = list(
        follow(
            JacobianController(robot), robot, "mujoco", "anchor", "line", episodes=1, frame_skip=5
        )
    )
    assert [sample.step for sample in samples] == list(range(125, 1001, 125))
    assert samples[0].tip_error > samples[-1].tip_error
    settled = samples[3:]
    assert all(sample.tip_error < 0.03 for sample in settled)
    assert 0 < max(sample.base_position_error for sample in settled) < 0.01
    assert 0 < max(sample.base_attitude_error for sample in settled) < 0.1


def test_around_is_all_around_the_arm_wherever_a_policy_was_trained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot, asked = load_robot("paper"), []

    def measured(*arguments: object, **_: object) -> object:
        asked.append(arguments[2:4])
        return SimpleNamespace(success=[True], length=[100], distance=[0.02])

    monkeypatch.setattr(evaluations, "evaluate", measured)
    subject = evaluations.Subject(
        RunDescription(algorithm="batd3", space="spatter"), JacobianController(robot), robot
    )
    rows = list(EVALUATIONS["workspace"].measure(subject, 1))
    assert asked == [(engine, "workspace") for engine in backend_names()]
    assert [row[:2] for row in rows] == asked


def test_a_file_with_too_few_episodes_is_not_done(tmp_path: Path) -> None:
    path, nominal = tmp_path / "nominal.csv", EVALUATIONS["nominal"]
    assert not nominal.is_done(path, 2)
    rows = [("mujoco", "anchor", "nominal", "0", i, 1, 100, "0.02") for i in range(2)]
    path.write_text("\n".join(",".join(map(str, row)) for row in [EPISODE_COLUMNS, *rows]) + "\n")
    assert nominal.is_done(path, 2)
    assert not nominal.is_done(path, 3)
    path.write_text("something else\n1\n")
    with pytest.raises(CdcsrError, match="no column episode"):
        nominal.is_done(path, 2)
    assert EVALUATIONS["follow"].episodes(100) == evaluations.FOLLOW_EPISODES


# -- jobs


@pytest.fixture
def quick_evaluation(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Replaces what is measured by a row that costs nothing, and counts how often."""
    counts: Counter[str] = Counter()

    def fake(name: str) -> Evaluation:
        def measure(subject: evaluations.Subject, episodes: int) -> list[tuple[object, ...]]:
            counts[f"{subject.spec.algorithm} {name}"] += 1
            return [("mujoco", "anchor", name, 0, i, 1, 100, 0.02) for i in range(episodes)]

        return Evaluation(EPISODE_COLUMNS, measure)  # type: ignore[arg-type]

    monkeypatch.setattr(
        evaluations, "EVALUATIONS", {name: fake(name) for name in ("nominal", "disturbances")}
    )
    return counts


def test_only_what_is_missing_is_done(tmp_path: Path, quick_evaluation: Counter[str]) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = Job(RunDescription(algorithm=SCRIPTED, updates=0), ("nominal",), TINY_BUDGET)
    assert not job.is_done(results)
    jobs.carry_out(job, runs, results)
    jobs.carry_out(job, runs, results)
    more = replace(job, evaluations=("nominal", "disturbances"))
    assert job.is_done(results)
    assert more.missing(results) == ["disturbances"]
    jobs.carry_out(more, runs, results)
    assert quick_evaluation == {"jacobian nominal": 1, "jacobian disturbances": 1}
    longer = replace(job, budget=replace(TINY_BUDGET, episodes=3))
    assert longer.missing(results) == ["nominal"]
    folder = results / job.name
    assert sorted(path.name for path in folder.iterdir()) == [
        "disturbances.csv",
        "nominal.csv",
        "run.json",
    ]
    record = json.loads((folder / "run.json").read_text())
    assert record["spec"] == {**job.spec.as_dict(), "budget": "tiny"}
    assert record["robot"] == "paper"
    assert record["fingerprint"] == load_robot("paper").fingerprint


def test_a_record_that_is_missing_is_not_done(
    tmp_path: Path, quick_evaluation: Counter[str]
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = Job(RunDescription(algorithm=SCRIPTED, updates=0), ("nominal",), TINY_BUDGET)
    jobs.carry_out(job, runs, results)
    (results / job.name / "run.json").unlink()
    left = temporary_beside(results / job.name / "nominal.csv")
    left = left.with_name(left.name.replace(f"-{os.getpid()}-", "-999999999-"))  # of a dead process
    left.write_text("half")
    assert not job.is_done(results)
    jobs.carry_out(job, runs, results)
    assert job.is_done(results)
    assert quick_evaluation == {"jacobian nominal": 1}
    assert sorted(path.name for path in (results / job.name).iterdir()) == [
        "nominal.csv",
        "run.json",
    ]


def test_results_are_of_one_policy(tmp_path: Path, quick_evaluation: Counter[str]) -> None:
    """Results without their policy: it is trained anew, and rounds differently elsewhere."""
    runs, results = tmp_path / "runs", tmp_path / "results"
    job, both = tiny_job(), tiny_job(evaluations=("nominal", "disturbances"))
    record = results / job.name / "run.json"
    jobs.carry_out(job, runs, results)
    shutil.rmtree(runs)
    jobs.carry_out(both, runs, results)
    assert quick_evaluation == {"td3 nominal": 1, "td3 disturbances": 1}, "the same to the bit"
    (results / job.name / "disturbances.csv").unlink()
    write_json(record, read_json(record) | {"policy": "another"})
    jobs.carry_out(both, runs, results)
    assert quick_evaluation == {"td3 nominal": 2, "td3 disturbances": 2}
    record.unlink()
    (results / job.name / "disturbances.csv").unlink()
    jobs.carry_out(both, runs, results)
    assert quick_evaluation == {"td3 nominal": 2, "td3 disturbances": 3}, "killed when half done"
    shutil.rmtree(runs)
    record.unlink()
    (results / job.name / "disturbances.csv").unlink()
    jobs.carry_out(both, runs, results)
    assert quick_evaluation == {"td3 nominal": 3, "td3 disturbances": 4}


def test_results_are_of_one_policy_if_making_them_again_is_interrupted(
    tmp_path: Path, quick_evaluation: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = tiny_job(evaluations=("nominal", "disturbances"))
    record = results / job.name / "run.json"
    jobs.carry_out(job, runs, results)
    write_json(record, read_json(record) | {"policy": "another"})
    (results / job.name / "nominal.csv").unlink()
    whole = evaluations.EVALUATIONS["disturbances"]

    def killed(*_: object) -> list[tuple[object, ...]]:
        raise KeyboardInterrupt

    monkeypatch.setitem(evaluations.EVALUATIONS, "disturbances", replace(whole, measure=killed))
    with pytest.raises(KeyboardInterrupt):
        jobs.carry_out(job, runs, results)
    monkeypatch.setitem(evaluations.EVALUATIONS, "disturbances", whole)
    assert not job.is_done(results)
    jobs.carry_out(job, runs, results)
    assert job.is_done(results)
    assert quick_evaluation["td3 disturbances"] == 2
    assert quick_evaluation["td3 nominal"] in (2, 3)


def test_a_policy_that_was_trained_with_other_numbers_is_not_measured(
    tmp_path: Path, quick_evaluation: Counter[str]
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = tiny_job()
    jobs.carry_out(job, runs, results)
    shutil.rmtree(results)
    path = runs / job.name / "config.json"
    config = read_json(path)
    write_json(path, config | {"learner": config["learner"] | {"discount": 0.5}})
    with pytest.raises(CdcsrError, match=r"learner\.discount"):
        jobs.carry_out(job, runs, results)
    assert quick_evaluation["td3 nominal"] == 1


def test_results_of_another_learner_are_not_taken_for_done(tmp_path: Path) -> None:
    job = tiny_job()
    record = tmp_path / job.name / "run.json"
    write_json(record, {"learner": numbers_of(job.spec).model_dump(mode="json")})
    assert job.changed(tmp_path) == []
    other = numbers_of(job.spec).model_dump(mode="json") | {"discount": 0.5}
    write_json(record, {"learner": other})
    assert job.changed(tmp_path) == [
        f"discount 0.5, now {numbers_of(job.spec).model_dump()['discount']}"
    ]


@pytest.mark.parametrize(
    ("job", "message"),
    [
        (tiny_job(algorithm="batd4"), "Unknown algorithm 'batd4'"),
        (tiny_job(evaluations=("nominl",)), "Unknown evaluation"),
    ],
)
def test_a_misspelt_name_is_said_before_the_work(tmp_path: Path, job: Job, message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    assert list(tmp_path.iterdir()) == []


# -- the command


def test_the_command_lists_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = ["--runs", str(tmp_path / "runs"), "--results", str(tmp_path / "results")]
    folders += ["--store", str(tmp_path / "store")]

    def command(*arguments: str) -> tuple[int, str]:
        code = run(experiments, "training.experiments", [*arguments, *folders])
        captured = capsys.readouterr()
        return code, captured.out + captured.err

    code, text = command("--list")
    assert code == 0
    assert all(name in text for name in EXPERIMENTS)
    code, text = command("table4", "--list", "--budget", "quick", "--only", "bc-*")
    assert code == 0
    assert text.count("bc-tuned_") == 3
    assert command()[0] == 2
    assert "Unknown experiment 'tabel2'" in command("all", "tabel2")[1]
    assert "--executor ray" in command("table2", "--address", "here:1")[1]
    assert "--jobs is for this machine" in command("table2", "--jobs", "2", "--executor", "ray")[1]
    code, text = command("tabel2")
    assert code == 2
    assert "Did you mean 'table2'" in text
    assert "fits the pattern" in command("table2", "--only", "nothing*")[1]
    assert not (tmp_path / "results").exists()


def test_the_command_takes_no_results_of_another_learner(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = collect(["table4"], BUDGETS["quick"])
    (name,) = [name for name in cells if name.startswith("bc-tuned_anchor")]
    learner = numbers_of(cells[name][0]).model_dump(mode="json")
    record = tmp_path / name / "run.json"
    arguments = [
        "table4",
        "--budget",
        "quick",
        "--only",
        name,
        "--runs",
        str(tmp_path / "runs"),
        "--results",
        str(tmp_path),
        "--store",
        str(tmp_path / "store"),
    ]
    write_json(record, {"learner": learner | {"bc_updates": 5}})
    assert run(experiments, "training.experiments", arguments) == 2
    assert "other numbers of the learner (bc_updates 5, now 3000)" in capsys.readouterr().err
    record.write_text("{", "utf-8")
    assert run(experiments, "training.experiments", arguments) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
