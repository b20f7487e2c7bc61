"""The study: its grid, its locks, and what survives when its processes are killed."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cdcsr.cli import run
from cdcsr.errors import CdcsrError
from cdcsr.robot import load_robot
from controllers.jacobian import JacobianController
from training.experiments import experiments
from training.study import evaluations, jobs
from training.study.evaluations import EPISODE_COLUMNS, EVALUATIONS, FOLLOW_COLUMNS, Evaluation
from training.study.follow import CIRCLE_RADIUS, REST_STEPS, attitude_error, displacement, follow
from training.study.grid import BUDGETS, EXPERIMENTS, Budget, collect, expected, summary
from training.study.jobs import Job, environment
from training.study.local import carry_out_here
from training.study.locks import STALE_AFTER, Busy, is_held, lock
from training.study.spec import SCRIPTED, RunSpec

_TINY = (("batch_size", 32), ("bc_rollouts", 4), ("bc_updates", 100), ("hidden", (16, 16)), ("num_envs", 4))
_BUDGET = Budget("tiny", 1, 60, 60, 2, 20, 2)


def _job(updates: int = 60, evaluations: tuple[str, ...] = ("nominal",), **options: object) -> Job:
    spec = replace(RunSpec("td3", updates=updates, demonstrations=1, switches=_TINY), **options)
    return Job(spec, evaluations, _BUDGET)


# -- the grid ----------------------------------------------------------------------------------------------------


def test_a_name_is_one_run_and_a_run_one_name() -> None:
    base = RunSpec("batd3", space="spatter")
    assert base.name == "batd3-tuned_spatter_mujoco_d10_u6000_s0"
    others = [
        replace(base, **{name: value})
        for name, value in {
            "algorithm": "bc", "preset": "paper", "backend": "pybullet", "space": "anchor", "task": "quiet", "seed": 1,
            "demonstrations": 5, "updates": 10, "randomize": 0.5, "switches": (("critics", 3),),
        }.items()
    ]  # fmt: skip
    assert len({spec.name for spec in [base, *others]}) == 11
    assert replace(base, switches=(("hidden", (8, 8)), ("critics", 3))).name.endswith("_s0_critics=3_hidden=8x8")


def test_a_run_is_read_back_as_it_was_written() -> None:
    spec = RunSpec("batd3", seed=3, randomize=0.5, switches=_TINY)
    assert RunSpec.from_json(spec.to_json()) == spec
    job = Job(spec, ("nominal", "follow"), _BUDGET)
    assert Job.from_json(job.to_json()) == job
    with pytest.raises(CdcsrError, match="not a run of the study"):
        RunSpec.from_json('{"algorithm": "bc", "colour": "red"}')
    with pytest.raises(CdcsrError, match=r"Unknown field of the learner 'critic'\. Did you mean 'critics'"):
        RunSpec("batd3", switches=(("critic", 3),))


def test_switches_and_counts_reach_the_training_run() -> None:
    config = RunSpec("td3", demonstrations=5, updates=77, seed=2, switches=(("critics", 3),)).train(Path("x"))
    assert (config.num_demonstrations, config.learner.updates, config.seed, config.learner.critics) == (5, 77, 2, 3)


@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
def test_every_experiment_is_said_and_has_each_seed(budget: Budget) -> None:
    names = expected(budget)
    for experiment, runs in names.items():
        assert summary(experiment).endswith(".")
        assert len(runs) == len(set(runs))
        cells = collect([experiment], budget)
        assert {spec.seed for spec, _ in cells.values()} == set(range(budget.seeds))
        trained = [spec for spec, _ in cells.values() if spec.algorithm != SCRIPTED]
        assert all(spec.updates == budget.length(spec.preset) for spec in trained)
    # Together each run comes once, with the evaluations of all: Table IV's are runs of Table II.
    both = collect(["table2", "table4"], budget)
    assert list(both) == names["table2"] or set(both) >= set(names["table2"])
    assert both[f"batd3-tuned_spatter_mujoco_d10_u{budget.updates}_s0"][1] == ("nominal", "disturbances")
    seeds = [spec.seed for spec, _ in collect(list(EXPERIMENTS), budget).values()]
    assert seeds == sorted(seeds)


# -- locks -------------------------------------------------------------------------------------------------------


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
    code = "import sys, time; from pathlib import Path; from training.study.locks import lock\n"
    code += "with lock(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    with pytest.raises(Busy), lock(path):
        pass
    process.kill()
    process.stdout.close()
    # Also before its parent has asked how it ended.
    deadline = time.monotonic() + 10
    while is_held(path) and time.monotonic() < deadline:
        time.sleep(0.01)
    with lock(path):
        assert is_held(path)
    process.wait()
    assert list(tmp_path.iterdir()) == []


def test_a_holder_on_another_machine_is_believed_as_long_as_it_shows_life(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    path.write_text(json.dumps({"pid": 1, "host": "elsewhere", "started": None, "token": "x"}))
    with pytest.raises(Busy, match="on elsewhere"), lock(path):
        pass
    before = time.time() - STALE_AFTER - 5
    os.utime(path, (before, before))
    with lock(path):
        assert "elsewhere" not in path.read_text()


def test_a_dead_lock_is_taken_by_one_only(tmp_path: Path) -> None:
    path, holders, most = tmp_path / "run.lock", list[int](), list[int]()
    path.write_text(json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "started": "0", "token": "x"}))
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


# -- evaluations -------------------------------------------------------------------------------------------------


def test_the_angle_between_attitudes() -> None:
    half = np.pi / 8
    turned = np.array([[np.cos(half), 0, np.sin(half), 0], [-np.cos(half), 0, -np.sin(half), 0]])
    still = np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0]])
    np.testing.assert_allclose(attitude_error(turned, still), np.pi / 4)


def test_moving_targets_start_where_they_rested() -> None:
    for motion in ("down", "circle"):
        np.testing.assert_array_equal(displacement(motion, 0.0), 0.0)
    np.testing.assert_allclose(displacement("down", 1.25), [0, 0, -0.125])
    np.testing.assert_allclose(displacement("circle", 1.25 / 2), [-2 * CIRCLE_RADIUS, 0, 0], atol=1e-12)


def test_the_demonstrator_follows_what_moves() -> None:
    robot = load_robot("paper")
    samples = list(follow(JacobianController(robot), robot, "mujoco", "anchor", "down", episodes=1, frame_skip=5))
    assert [sample.step for sample in samples] == list(range(25, 751, 25))
    assert samples[0].tip_error > 0.1
    # It lags by the target's speed over its gain, 0.1 m/s / (14 1/s) = 7 mm, once it has settled.
    settled = [sample for sample in samples if sample.step > REST_STEPS + 200]
    assert all(0.004 < sample.tip_error < 0.01 for sample in settled)
    assert 0 < max(sample.base_position_error for sample in settled) < 0.01
    assert 0 < max(sample.base_attitude_error for sample in settled) < 0.1


def test_a_file_with_too_few_episodes_is_not_done(tmp_path: Path) -> None:
    path, nominal = tmp_path / "nominal.csv", EVALUATIONS["nominal"]
    assert not nominal.is_done(path, 2)
    rows = [("mujoco", "anchor", "nominal", "0", i, 1, 100, "0.02") for i in range(2)]
    path.write_text("\n".join(",".join(map(str, row)) for row in [EPISODE_COLUMNS, *rows]) + "\n")
    assert nominal.is_done(path, 2)
    assert not nominal.is_done(path, 3)
    assert EVALUATIONS["follow"].episodes(100) == evaluations.FOLLOW_EPISODES


# -- jobs --------------------------------------------------------------------------------------------------------


@pytest.fixture
def quick_evaluation(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Replaces what is measured by a row that costs nothing, and counts how often."""
    counts: Counter[str] = Counter()

    def fake(name: str) -> Evaluation:
        def measure(subject: evaluations.Subject, episodes: int) -> list[tuple[object, ...]]:
            counts[f"{subject.spec.algorithm} {name}"] += 1
            return [("mujoco", "anchor", name, 0, i, 1, 100, 0.02) for i in range(episodes)]

        return Evaluation(EPISODE_COLUMNS, measure)  # type: ignore[arg-type]

    monkeypatch.setattr(evaluations, "EVALUATIONS", {name: fake(name) for name in ("nominal", "disturbances")})
    return counts


def test_only_what_is_missing_is_done(tmp_path: Path, quick_evaluation: Counter[str]) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = Job(RunSpec(SCRIPTED, updates=0), ("nominal",), _BUDGET)
    assert not job.is_done(results)
    jobs.carry_out(job, runs, results)
    jobs.carry_out(job, runs, results)
    more = replace(job, evaluations=("nominal", "disturbances"))
    assert job.is_done(results)
    assert more.missing(results) == ["disturbances"]
    jobs.carry_out(more, runs, results)
    assert quick_evaluation == {"jacobian nominal": 1, "jacobian disturbances": 1}
    longer = replace(job, budget=replace(_BUDGET, episodes=3))
    assert longer.missing(results) == ["nominal"]
    folder = results / job.name
    assert sorted(path.name for path in folder.iterdir()) == ["disturbances.csv", "nominal.csv", "run.json"]
    record = json.loads((folder / "run.json").read_text())
    assert record["spec"] == {**job.spec.as_dict(), "budget": "tiny"}
    assert record["robot"] == "paper"
    assert record["fingerprint"] == load_robot("paper").fingerprint


def test_a_record_that_is_missing_is_not_done(tmp_path: Path, quick_evaluation: Counter[str]) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    job = Job(RunSpec(SCRIPTED, updates=0), ("nominal",), _BUDGET)
    jobs.carry_out(job, runs, results)
    (results / job.name / "run.json").unlink()
    (results / job.name / ".nominal.csv.0badcafe").write_text("half")
    assert not job.is_done(results)
    jobs.carry_out(job, runs, results)
    assert job.is_done(results)
    assert quick_evaluation == {"jacobian nominal": 1}
    assert sorted(path.name for path in (results / job.name).iterdir()) == ["nominal.csv", "run.json"]


@pytest.mark.parametrize(
    ("job", "message"),
    [(_job(algorithm="batd4"), "Unknown algorithm 'batd4'"), (_job(evaluations=("nominl",)), "Unknown evaluation")],
)
def test_a_misspelt_name_is_said_before_the_work(tmp_path: Path, job: Job, message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    assert list(tmp_path.iterdir()) == []


# -- the command -------------------------------------------------------------------------------------------------


def test_the_command_lists_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = ["--runs", str(tmp_path / "runs"), "--results", str(tmp_path / "results")]

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
    code, text = command("tabel2")
    assert code == 2
    assert "Did you mean 'table2'" in text
    assert "fits the pattern" in command("table2", "--only", "nothing*")[1]
    begun = tmp_path / "runs" / "bc-tuned_anchor_mujoco_d10_u6000_s0"
    begun.mkdir(parents=True)
    (begun / "config.json").write_text("{}")
    code, text = command("table2")
    assert code == 2
    assert f"1 runs in {tmp_path / 'runs'} were begun and not finished, the first is {begun.name}" in text
    assert not (tmp_path / "results").exists()


# -- processes, killed -------------------------------------------------------------------------------------------


def _until(happens: Callable[[], bool], process: subprocess.Popen[bytes] | None = None, seconds: float = 300) -> None:
    deadline = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < deadline
        assert process is None or process.poll() is None
        time.sleep(0.02)


def _start(job: Job, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        job.command(folder / "runs", folder / "results"), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env=environment(),
    )  # fmt: skip


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None
    process.stdin.close()


@pytest.mark.slow
def test_a_job_killed_in_training_and_in_evaluation_ends_as_if_it_had_not_been(tmp_path: Path) -> None:
    job, whole = _job(120), tmp_path / "whole"
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
    for name in ("nominal.csv",):
        assert (results / name).read_text() == (whole / "results" / job.name / name).read_text()
    with (results / "metrics.csv").open() as file:
        assert [row["update"] for row in csv.DictReader(file)] == ["20", "40", "60", "80", "100", "120"]
    assert not list((tmp_path / "runs").glob("*.lock"))


@pytest.mark.slow
def test_two_jobs_side_by_side_and_one_that_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    good = _job(evaluations=("nominal", "follow"))
    wanted = [_job(algorithm="batd4"), good, _job(algorithm="bc")]
    outcome = carry_out_here(wanted, runs, results, slots=2)
    assert set(outcome.finished) == {wanted[1].name, wanted[2].name}
    assert "Unknown algorithm 'batd4'" in outcome.failed[wanted[0].name]
    assert "[3/3]" in capsys.readouterr().out
    again = carry_out_here(wanted[1:], runs, results, slots=2)
    assert again.skipped == [wanted[1].name, wanted[2].name]
    # The contract of the files.
    folder = results / good.name
    assert sorted(p.name for p in folder.iterdir()) == ["follow.csv", "metrics.csv", "nominal.csv", "run.json"]
    record = json.loads((folder / "run.json").read_text())
    assert set(record) == {
        "spec", "minutes", "updates", "environment_steps", "versions", "robot", "fingerprint"
    }  # fmt: skip
    assert (record["updates"], record["environment_steps"]) == (60, 240)
    assert record["spec"]["switches"]["hidden"] == [16, 16]
    with (folder / "nominal.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == EPISODE_COLUMNS
    cells = Counter((row["backend"], row["space"]) for row in rows)
    assert set(cells.values()) == {2}
    assert set(cells) == {(b, s) for b in ("mujoco", "pybullet") for s in ("anchor", "floating", "spatter")}
    with (folder / "follow.csv").open() as file:
        follows = list(csv.DictReader(file))
    assert tuple(follows[0]) == FOLLOW_COLUMNS
    assert len(follows) == 2 * 2 * 2 * 30


@pytest.mark.slow
def test_the_jobs_of_a_killed_executor_end_and_are_taken_over(tmp_path: Path) -> None:
    job = _job(100_000)
    code = (
        "import sys; from pathlib import Path; from training.study.jobs import Job; "
        "from training.study.local import carry_out_here; "
        "carry_out_here([Job.from_json(sys.argv[1])], Path(sys.argv[2]), Path(sys.argv[3]), 1)"
    )
    runs, results = tmp_path / "runs", tmp_path / "results"
    command = [sys.executable, "-c", code, job.to_json(), str(runs), str(results)]
    executor = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    path = runs / f"{job.name}.lock"
    _until((runs / job.name / "state.safetensors").exists, executor)
    assert is_held(path)
    worker = json.loads(path.read_text())["pid"]
    executor.kill()
    executor.wait()
    _until(lambda: not is_held(path), seconds=20)
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)
    # Ctrl-C: the executor ends its jobs before it ends.
    executor = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _until(lambda: is_held(path), executor)
    executor.send_signal(signal.SIGINT)
    executor.wait(30)
    assert not is_held(path)
    assert job.is_begun(runs)
