"""Jobs: what they leave, and that their processes may be killed."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.locks import lock
from cdcsr.simulation.engines import backend_names
from tests.support.tiny import TINY_BUDGET, is_held, tiny_job
from training.config.run_description import SCRIPTED, RunDescription
from training.policy import load_policy
from training.run import trainer
from training.run.train_options import Train
from training.study.execute import evaluations, jobs, local
from training.study.execute.evaluations import EPISODE_COLUMNS, FOLLOW_COLUMNS, Evaluation
from training.study.execute.jobs import Job, environment
from training.study.execute.local import Outcome, carry_out_here


@pytest.mark.parametrize(
    "spec",
    [
        RunDescription(space="/elsewhere/map.npz"),
        RunDescription(task="../../elsewhere"),
        RunDescription(changes=(("features", "../elsewhere"),)),
    ],
    ids=lambda spec: spec.name,
)
def test_a_run_whose_name_leads_out_of_its_folder_is_refused(spec: RunDescription) -> None:
    with pytest.raises(CdcsrError, match="The name of a run must be a name of letters"):
        Job(spec, ("nominal",), TINY_BUDGET)


class StopError(Exception):
    """Instead of training."""


@pytest.mark.parametrize(("updates", "every"), [(60, 20), (800, 20), (840, 21), (100_000, 2_500)])
def test_a_learning_curve_has_forty_points_at_most(
    updates: int, every: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Train] = []

    def stop(config: Train) -> None:
        asked.append(config)
        raise StopError

    monkeypatch.setattr(trainer, "train", stop)
    job = replace(
        tiny_job(updates),
        budget=replace(TINY_BUDGET, episodes=2, evaluate_every=20, validation_episodes=3),
    )
    with pytest.raises(StopError):
        jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    (config,) = asked
    assert (config.evaluate_every, config.evaluate_episodes) == (every, 3)
    assert config.out == tmp_path / "runs" / job.name


def test_the_record_is_of_the_run_and_its_curve_is_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = ("mujoco", "anchor", "nominal", 0, 0, 1, 100, 0.02)
    monkeypatch.setattr(
        evaluations,
        "EVALUATIONS",
        {"nominal": Evaluation(EPISODE_COLUMNS, lambda _, num: iter([row] * num))},
    )
    job = tiny_job()
    job = replace(job, budget=replace(TINY_BUDGET, episodes=1))
    jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    out, folder = tmp_path / "runs" / job.name, tmp_path / "results" / job.name
    policy, record = load_policy(out), json.loads((folder / "run.json").read_text("utf-8"))
    assert record["policy"] == policy.digest
    assert 0 < record["minutes"] == policy.card["minutes"]
    assert (record["updates"], record["environment_steps"]) == (60, 60 * 4)
    assert (folder / "metrics.csv").read_bytes() == (out / "metrics.csv").read_bytes()


def _until(
    happens: Callable[[], bool],
    process: subprocess.Popen[bytes] | None = None,
    seconds: float = 300,
) -> None:
    deadline = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < deadline
        assert process is None or process.poll() is None
        time.sleep(0.02)


def _start(job: Job, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        job.command(folder / "runs", folder / "results"),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment(),
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None
    process.stdin.close()


@pytest.mark.slow
def test_a_job_killed_in_training_and_in_evaluation_ends_as_if_it_had_not_been(
    tmp_path: Path,
) -> None:
    job, whole = tiny_job(120), tmp_path / "whole"
    out, results = tmp_path / "runs" / job.name, tmp_path / "results" / job.name
    process = _start(job, tmp_path)
    _until((out / "state.safetensors").exists, process)
    _kill(process)
    assert job.is_begun(tmp_path / "runs")
    assert not results.exists()
    process = _start(job, tmp_path)
    _until((results / "metrics.csv").exists, process)  # training is over; the evaluation has begun
    _kill(process)
    assert not (results / "run.json").exists()
    trained = (out / "policy.safetensors").stat().st_mtime_ns
    outcome = carry_out_here([job], tmp_path / "runs", tmp_path / "results", slots=1)
    assert list(outcome.finished) == [job.name]
    assert (out / "policy.safetensors").stat().st_mtime_ns == trained  # nothing was trained again
    carry_out_here([job], whole / "runs", whole / "results", slots=1)
    assert (results / "nominal.csv").read_text() == (
        whole / "results" / job.name / "nominal.csv"
    ).read_text()
    with (results / "metrics.csv").open() as file:
        assert [float(row["update"]) for row in csv.DictReader(file)] == [20, 40, 60, 80, 100, 120]
    assert not list((tmp_path / "runs").glob("*.lock"))


@pytest.mark.slow
def test_two_jobs_side_by_side_and_one_that_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    good = tiny_job(evaluations=("nominal", "follow"))
    wanted = [tiny_job(algorithm="batd4"), good, tiny_job(algorithm="bc")]
    outcome = carry_out_here(wanted, runs, results, slots=2)
    assert set(outcome.finished) == {wanted[1].name, wanted[2].name}
    assert "Unknown algorithm 'batd4'" in outcome.failed[wanted[0].name]
    assert "[3/3]" in capsys.readouterr().out
    again = carry_out_here(wanted[1:], runs, results, slots=2)
    assert again.skipped == [wanted[1].name, wanted[2].name]
    # The contract of the files.
    folder = results / good.name
    assert sorted(p.name for p in folder.iterdir()) == [
        "follow.csv",
        "metrics.csv",
        "nominal.csv",
        "run.json",
    ]
    record = json.loads((folder / "run.json").read_text())
    assert set(record) == {
        "spec",
        "learner",
        "policy",
        "commit",
        "minutes",
        "updates",
        "environment_steps",
        "versions",
        "robot",
        "fingerprint",
    }
    assert (record["updates"], record["environment_steps"]) == (60, 240)
    assert record["spec"]["changes"]["hidden"] == [16, 16]
    with (folder / "nominal.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == EPISODE_COLUMNS
    cells = Counter((row["backend"], row["space"]) for row in rows)
    assert set(cells.values()) == {2}
    assert set(cells) == {
        (b, s) for b in backend_names() for s in ("anchor", "floating", "spatter")
    }
    with (folder / "follow.csv").open() as file:
        follows = list(csv.DictReader(file))
    assert tuple(follows[0]) == FOLLOW_COLUMNS
    assert (
        len(follows) == len(backend_names()) * 3 * 2 * 40
    )  # engines, motions, episodes, samples of each


@pytest.mark.slow
def test_the_jobs_of_a_killed_executor_end_and_are_taken_over(tmp_path: Path) -> None:
    job = tiny_job(100_000)
    code = (
        "import signal, sys; from pathlib import Path; "
        "from training.study.execute.jobs import Job; "
        "from training.study.execute.local import carry_out_here; "
        # A shell's background processes ignore Ctrl-C, and their children inherit that.
        "signal.signal(signal.SIGINT, signal.default_int_handler); "
        "carry_out_here([Job.from_json(sys.argv[1])], Path(sys.argv[2]), Path(sys.argv[3]), 1)"
    )
    runs, results = tmp_path / "runs", tmp_path / "results"
    command = [sys.executable, "-c", code, job.to_json(), str(runs), str(results)]
    executor = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    path = runs / f"{job.name}.lock"
    _until((runs / job.name / "state.safetensors").exists, executor)
    assert is_held(path)
    executor.kill()
    executor.wait()
    _until(lambda: not is_held(path), seconds=20)  # its process is gone
    assert path.exists()
    # Ctrl-C: the executor ends its jobs before it ends.
    executor = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _until(lambda: is_held(path), executor)
    executor.send_signal(signal.SIGINT)
    executor.wait(30)
    assert not path.exists()
    assert job.is_begun(runs)


@pytest.mark.slow
def test_a_run_that_another_process_is_at_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "RETRY_BUSY", 0.5)
    job, runs, results = (
        Job(RunDescription(algorithm=SCRIPTED, updates=0), ("nominal",), TINY_BUDGET),
        tmp_path / "runs",
        tmp_path / "out",
    )
    outcomes: list[Outcome] = []
    executor = threading.Thread(
        target=lambda: outcomes.append(carry_out_here([job], runs, results, slots=1))
    )
    log = runs / f"{job.name}.log"
    with lock(runs / f"{job.name}.lock"):
        executor.start()
        _until(lambda: log.is_file() and "is held by the live process" in log.read_text())
        assert executor.is_alive()
        assert not results.exists()
    executor.join()
    assert list(outcomes[0].finished) == [job.name]
    assert job.is_done(results)
