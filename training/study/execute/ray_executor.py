"""Do jobs on a Ray cluster, each as a task of one processor. Needs the extra `ray`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError
from cdcsr.leftovers import make_folder
from cdcsr.locks import STALE_AFTER, Busy
from training.study.execute.jobs import Job
from training.study.execute.local import Outcome, Progress, duration, failure, log_path

RETRIES = 10
"""How often a job is given to another node when its node is lost."""
RETRY_BUSY = 2.0
"""Seconds until a job that another process works on is tried again."""


def carry_out_on_ray(
    jobs: Sequence[Job], runs: Path, results: Path, address: str | None
) -> Outcome:
    """Do jobs on a cluster; neither a job that fails nor a node that is lost stops the others.

    Every node must have this package installed, and must see the folders `runs` and `results` at
    the same paths as this machine.

    Args:
        jobs: the jobs, in the order in which they are started.
        runs: folder of the training runs, their logs and their locks.
        results: working folder of the results.
        address: address of a running cluster, as for `ray.init`; None starts one on this machine
            for as long as it is needed.

    Raises:
        CdcsrError: Ray is not installed, or there is no cluster at that address.
    """
    ray = _import_ray()
    runs, results = runs.resolve(), results.resolve()
    outcome, left = Outcome(), list[Job]()
    for job in jobs:
        if job.is_done(results):
            outcome.skipped.append(job.name)
            print(f"{job.name}: done before", flush=True)
        else:
            left.append(job)
    if not left:
        return outcome
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise CdcsrError(f"There is no Ray cluster at {address!r}: {_first_line(error)}.") from None
    try:
        processors = int(ray.cluster_resources().get("CPU", 1))
        print(
            f"{len(left)} runs on {len(ray.nodes())} nodes with {processors} processors", flush=True
        )
        progress = Progress(left, max(1, processors))
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(do_one)
        waiting = {task.remote(job.to_json(), str(runs), str(results)): job for job in left}
        while waiting:
            (done, *_), _ = ray.wait(list(waiting))
            _conclude(ray, done, waiting.pop(done), runs, results, outcome, progress)
    finally:
        ray.shutdown()
    return outcome


def do_one(text: str, runs: str, results: str) -> tuple[int, float]:
    """Do one job on the node where this is called.

    The job's process ends with the calling one. A lock that a lost node left behind is waited for.

    Args:
        text: the job, as JSON.
        runs: folder of the training runs, an absolute path.
        results: working folder of the results, an absolute path.

    Returns:
        The exit code, and the minutes it took.
    """
    job, runs_folder, folder = Job.from_json(text), Path(runs), Path(results)
    make_folder(runs_folder)
    started = time.monotonic()
    while True:
        with log_path(job, runs_folder).open("ab") as log:
            process = job.start(runs_folder, folder, log)
            code = process.wait()
        if code != Busy.exit_code or time.monotonic() - started > 2 * STALE_AFTER:
            break
        time.sleep(RETRY_BUSY)
    return code, (time.monotonic() - started) / 60


def _conclude(
    ray: Any,
    done: object,
    job: Job,
    runs: Path,
    results: Path,
    outcome: Outcome,
    progress: Progress,
) -> None:
    try:
        code, minutes = ray.get(done)
    except ray.exceptions.RayError as error:
        outcome.failed[job.name] = _first_line(error)
        progress.done(job, f"failed, {outcome.failed[job.name]}")
        return
    if code == 0 and job.is_done(results):
        outcome.finished[job.name] = minutes
        progress.done(job, f"finished in {duration(minutes)}", minutes)
    else:
        outcome.failed[job.name] = failure(code, log_path(job, runs))
        progress.done(job, f"failed, {outcome.failed[job.name]}")


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def _import_ray() -> Any:  # an extra that type checkers need not find
    try:
        return import_module("ray")
    except ModuleNotFoundError:
        raise CdcsrError(
            "Ray is not installed; install it with pip install 'cdcsr[ray]'."
        ) from None
