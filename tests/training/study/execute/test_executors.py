"""Executors: the work that is left, jobs that failed, retries, and a Ray cluster of two nodes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from cdcsr.errors import CdcsrError
from cdcsr.locks import Busy
from tests.support.tiny import TINY_BUDGET, tiny_changes, tiny_job
from training.experiments import experiments
from training.run.trainer import train
from training.study.execute import ray_executor
from training.study.execute.gpu_executor import carry_out_on_gpu
from training.study.execute.jobs import Job, carry_out
from training.study.execute.local import Outcome, Progress, duration, failure
from training.study.execute.ray_executor import carry_out_on_ray, do_one


def _job(algorithm: str, seed: int) -> Job:
    job = tiny_job(algorithm=algorithm)
    return replace(job, spec=replace(job.spec, seed=seed))


def test_what_is_left_is_guessed_by_algorithm_and_shared_by_the_slots(
    capsys: pytest.CaptureFixture[str],
) -> None:
    jobs = [*(_job("td3", seed) for seed in range(4)), _job("bc", 0)]
    progress, said = Progress(jobs, slots=2), []
    for job, minutes in (
        (jobs[0], None),
        (jobs[1], 20.0),
        (jobs[4], 100.0),
        (jobs[2], 40.0),
        (jobs[3], 1.0),
    ):
        progress.done(job, "done", minutes)
        said.append(capsys.readouterr().out.strip().partition(": done")[2])
    # Nothing is known; two of 20 minutes and one like those known; two of 20; one of 30, the mean
    # of two.
    assert said == [
        "",
        "; about 30.0 min left",
        "; about 20.0 min left",
        "; about 15.0 min left",
        "",
    ]


def test_durations_are_hours_from_an_hour_and_a_half() -> None:
    assert [duration(x) for x in (0.25, 89.9, 90, 150)] == ["0.2 min", "89.9 min", "1.5 h", "2.5 h"]


def test_a_failure_is_the_end_of_the_log(tmp_path: Path) -> None:
    log = tmp_path / "job.log"
    log.write_text("begun\nError: no disk \n\n")
    assert failure(-9, log) == f"killed by signal 9 ({log}): Error: no disk"
    assert failure(2, log) == f"exit code 2 ({log}): Error: no disk"
    log.write_text("\n")
    assert failure(1, log).endswith(": nothing in the log")


def _codes(monkeypatch: pytest.MonkeyPatch, codes: list[int]) -> list[Job]:
    """Let processes end at once, with these exit codes in turn; return the started jobs."""
    started: list[Job] = []

    def start(job: Job, *_: object) -> SimpleNamespace:
        started.append(job)
        return SimpleNamespace(wait=lambda: codes[len(started) - 1])

    monkeypatch.setattr(Job, "start", start)
    monkeypatch.setattr(ray_executor, "RETRY_BUSY", 0.0)
    return started


@pytest.mark.parametrize("codes", [[0], [1], [-9], [Busy.exit_code, Busy.exit_code, 0]])
def test_only_a_job_that_another_is_at_is_tried_again(
    codes: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, job = _codes(monkeypatch, codes), tiny_job()
    code, minutes = do_one(job.to_json(), str(tmp_path / "runs"), str(tmp_path / "results"))
    assert (code, len(started)) == (codes[-1], len(codes))
    assert 0 <= minutes < 1
    assert started[0] == job


def test_a_lock_that_does_not_become_free_is_not_waited_for_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = _codes(monkeypatch, [Busy.exit_code] * 2)
    monkeypatch.setattr(ray_executor, "STALE_AFTER", -1.0)
    assert do_one(tiny_job().to_json(), str(tmp_path), str(tmp_path))[0] == Busy.exit_code
    assert len(started) == 1


class LostError(Exception):
    """As Ray raises where a node is lost too often."""


class Cluster:
    """Stands in for Ray: tasks end when they are waited for, last first, as is written down."""

    exceptions = SimpleNamespace(RayError=LostError)

    def __init__(self, ends: dict[str, tuple[int, float] | Exception]) -> None:
        self.ends, self.down = ends, False

    def init(self, **_: object) -> None:
        pass

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 2.0}

    def nodes(self) -> list[int]:
        return [0]

    def remote(self, **_: object) -> Callable[[object], SimpleNamespace]:
        return lambda _: SimpleNamespace(remote=lambda text, *_: Job.from_json(text).name)

    def wait(self, waiting: list[str]) -> tuple[list[str], list[str]]:
        return waiting[-1:], waiting[:-1]

    def get(self, name: str) -> tuple[int, float]:
        end = self.ends[name]
        if isinstance(end, Exception):
            raise end
        return end

    def shutdown(self) -> None:
        self.down = True


def test_a_job_on_a_cluster_is_finished_if_its_results_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, whole, empty, wrong, lost = jobs = [_job("td3", seed) for seed in range(5)]
    ends = {
        whole.name: (0, 3.0),
        empty.name: (0, 1.0),
        wrong.name: (2, 1.0),
        lost.name: LostError("gone\nfor good"),
    }
    cluster, there = Cluster(ends), {before.name}
    monkeypatch.setattr(ray_executor, "_import_ray", lambda: cluster)
    monkeypatch.setattr(Job, "is_done", lambda job, _: job.name in there)
    monkeypatch.setattr(cluster, "init", lambda **_: there.update((whole.name, wrong.name)))
    for job in jobs:
        (tmp_path / f"{job.name}.log").write_text("the end")
    outcome = carry_out_on_ray(jobs, tmp_path, tmp_path, None)
    assert outcome.skipped == [before.name]
    assert outcome.finished == {whole.name: 3.0}
    assert outcome.failed.keys() == {empty.name, wrong.name, lost.name}
    assert outcome.failed[lost.name] == "gone"
    assert "exit code 2" in outcome.failed[wrong.name]
    assert cluster.down


_JOB = replace(tiny_job(400), budget=replace(TINY_BUDGET, evaluate_every=50))


@pytest.fixture
def cluster() -> Iterator[Any]:
    pytest.importorskip("ray", reason="the extra ray is not installed")
    from ray.cluster_utils import Cluster  # type: ignore[import-not-found]

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield made
    made.shutdown()


def _executor(jobs: list[Job], folder: Path, address: str) -> subprocess.Popen[str]:
    """Another process: Ray's own leaves sockets and warnings behind in this one."""
    code = (
        "import sys; from pathlib import Path; from training.study.execute.jobs import Job; "
        "from training.study.execute.ray_executor import carry_out_on_ray; "
        "jobs = [Job.from_json(j) for j in sys.argv[4:]];"
        "o = carry_out_on_ray(jobs, Path(sys.argv[1]), Path(sys.argv[2]),"
        " sys.argv[3]); print('failed', o.failed); sys.exit(bool(o.failed))"
    )
    folders = [str(folder / "runs"), str(folder / "results")]
    command = [sys.executable, "-c", code, *folders, address, *(job.to_json() for job in jobs)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def _ends(process: subprocess.Popen[str]) -> str:
    text, _ = process.communicate(timeout=500)
    assert process.returncode == 0, text
    return text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_lost_node_loses_nothing_and_nothing_runs_twice(tmp_path: Path, cluster: Any) -> None:
    second = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    jobs = [replace(_JOB, spec=replace(_JOB.spec, seed=seed)) for seed in range(4)]
    runs, results = tmp_path / "runs", tmp_path / "results"
    process = _executor(jobs, tmp_path, cluster.address)
    # Once the first run is finished and two others have a checkpoint, a node dies.
    deadline = time.monotonic() + 400
    while not list(results.glob("*/run.json")) or len(list(runs.glob("*/state.safetensors"))) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    finished = {path: path.stat().st_mtime_ns for path in results.glob("*/run.json")}
    held = {path.name: json.loads(path.read_text())["pid"] for path in runs.glob("*.lock")}
    cluster.remove_node(second, allow_graceful=False)
    assert "failed {}" in _ends(process)
    assert all(job.is_done(results) for job in jobs)
    assert all(path.stat().st_mtime_ns == before for path, before in finished.items())
    # Every run began once; that of the lost node was resumed from its checkpoint elsewhere.
    logs = [(runs / f"{job.name}.log").read_text() for job in jobs]
    points = [text.count("update ") for text in logs]
    begun = [text.count("Recording ") for text in logs]
    assert sorted(begun) == [1, 1, 1, 2], (begun, held)
    assert all(8 <= count <= 9 for count in points), (
        points
    )  # at most the point it was at is made again
    assert not list(runs.glob("*.lock"))
    # The same grid again: there is nothing to do.
    assert _ends(_executor(jobs, tmp_path, cluster.address)).count("done before") == 4
    assert all(path.stat().st_mtime_ns == before for path, before in finished.items())


def test_without_ray_or_without_a_cluster_one_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(CdcsrError, match=r"pip install 'cdcsr\[ray\]'"):
        carry_out_on_ray([_JOB], tmp_path / "runs", tmp_path / "results", None)


def test_runs_that_share_all_shapes_are_trained_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, results, device = tmp_path / "runs", tmp_path / "results", torch.device("cpu")
    pair, other = [_job("td3", seed) for seed in (3, 4)], tiny_job(70)
    pair[1] = replace(pair[1], spec=replace(pair[1].spec, space="spatter"))
    # Its folder holds a run of other numbers; the one beside it is trained all the same.
    wrong, mate = (replace(job, spec=replace(job.spec, updates=50)) for job in pair)
    train(replace(wrong.training(runs / wrong.name), stop_after=0.0))
    host = tiny_job(algorithm="clasp", changes=tiny_changes("clasp", hindsight=1))
    wanted = [pair[0], other, wrong, pair[1], tiny_job(0, algorithm="jacobian"), mate, host]
    wanted = [replace(job, evaluations=()) for job in wanted]

    def evaluate(left: Sequence[Job], runs: Path, results: Path, slots: int) -> Outcome:
        assert slots == 5
        for job in left:
            carry_out(job, runs, results)
        return Outcome(dict.fromkeys((job.name for job in left), 1.0))

    monkeypatch.setattr("training.study.execute.gpu_executor.carry_out_here", evaluate)
    outcome = carry_out_on_gpu(wanted, runs, results, 5, device)
    said = capsys.readouterr().out
    assert f"[1/4] {pair[0].name} and 1 beside it: trained in" in said
    assert f"[3/4] {wrong.name} and 1 beside it: 1 failed, first: " in said
    assert "other options (device)" in said
    assert f"{host.name}: left to the processors, hindsight must be 0" in said
    assert (runs / mate.name / "summary.json").exists()
    assert not (runs / host.name / "state.safetensors").exists()
    assert set(outcome.failed) == {wrong.name}
    assert set(outcome.finished) == {job.name for job in wanted if job.name != wrong.name}
    weights = {(runs / job.name / "policy.safetensors").read_bytes() for job in (*pair, other)}
    assert len(weights) == 3
    metrics = (results / pair[0].name / "metrics.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in metrics] == ["update", "20", "40", "60"]
    monkeypatch.setattr(
        "training.study.execute.gpu_executor.train_side_by_side",
        lambda *_: pytest.fail("trained again"),
    )
    done = [job for job in wanted if job.name != wrong.name]
    assert not carry_out_on_gpu(done, runs, results, 5, device).failed
    # A run that a GPU began is not one that a processor can go on with.
    (runs / other.name / "summary.json").unlink()
    shutil.rmtree(results / other.name)
    with pytest.raises(CdcsrError, match="was begun with --executor gpu"):
        carry_out(other, runs, results)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_the_executor_says_so(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="finds no GPU for --executor gpu"):
        experiments(
            ("table2",),
            executor="gpu",
            only="td3-*_s0",
            runs=tmp_path / "runs",
            results=tmp_path / "results",
            store=tmp_path / "store",
        )
