"""Do jobs on this machine, a few side by side, each in a process of its own."""

from __future__ import annotations

import subprocess
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from cdcsr.errors import CdcsrError
from cdcsr.leftovers import make_folder
from cdcsr.locks import Busy
from cdcsr.simulation.arguments import check_count
from training.study.execute.jobs import Job

POLL = 0.2
"""Seconds between two looks at the processes."""
RETRY_BUSY = 10.0
"""Seconds until a job that another process works on is tried again."""
GRACE = 5.0
"""Seconds a process has to end by itself when the work is interrupted."""


@dataclass
class Outcome:
    """The outcome of some jobs, by the names of their runs."""

    finished: dict[str, float] = field(default_factory=dict)
    """Finished jobs, and the minutes each took this time."""
    skipped: list[str] = field(default_factory=list)
    """Jobs that were done before."""
    failed: dict[str, str] = field(default_factory=dict)
    """Failed jobs, and why."""


class Progress:
    """Print how far the work is, and about how long it will still take."""

    def __init__(self, jobs: Sequence[Job], slots: int) -> None:
        self._left, self._slots = {job.name: job for job in jobs}, slots
        self._total, self._minutes = len(jobs), dict[str, list[float]]()

    def done(self, job: Job, what: str, minutes: float | None = None) -> None:
        """Print that a job is done; its `minutes`, if given, improve the estimate."""
        del self._left[job.name]
        if minutes is not None:
            self._minutes.setdefault(job.spec.algorithm, []).append(minutes)
        left = f"; about {duration(self._remaining())} left" if self._left and self._minutes else ""
        print(
            f"[{self._total - len(self._left)}/{self._total}] {job.name}: {what}{left}", flush=True
        )

    def _remaining(self) -> float:
        every = [m for minutes in self._minutes.values() for m in minutes]
        mean = {name: sum(minutes) / len(minutes) for name, minutes in self._minutes.items()}
        work = sum(
            mean.get(job.spec.algorithm, sum(every) / len(every)) for job in self._left.values()
        )
        return work / self._slots


@dataclass
class _Running:
    job: Job
    process: subprocess.Popen[bytes]
    log: IO[bytes]
    started: float

    @property
    def minutes(self) -> float:
        return (time.monotonic() - self.started) / 60


def carry_out_here(jobs: Sequence[Job], runs: Path, results: Path, slots: int) -> Outcome:
    """Do jobs side by side; one that fails does not stop the others.

    When this process ends, in whatever way, the jobs' processes end too; their files stay.

    Args:
        jobs: the jobs, in the order in which they are started.
        runs: folder of the training runs, their logs and their locks.
        results: working folder of the results.
        slots: how many jobs run at once.

    Raises:
        CdcsrError: `slots` is less than 1, or the folder `runs` cannot be made.
    """
    check_count("--jobs", slots, 1_000)
    try:
        make_folder(runs)
    except OSError as error:
        raise CdcsrError(f"Cannot make the folder {runs}: {error.strerror}.") from None
    outcome, progress = Outcome(), Progress(jobs, slots)
    waiting, busy = deque(jobs), deque[tuple[float, Job]]()
    running: list[_Running] = []
    try:
        while waiting or busy or running:
            while busy and busy[0][0] <= time.monotonic():
                waiting.append(busy.popleft()[1])
            while waiting and len(running) < slots:
                job = waiting.popleft()
                if job.is_done(results):
                    outcome.skipped.append(job.name)
                    progress.done(job, "done before")
                else:
                    running.append(_start(job, runs, results))
            for each in [r for r in running if r.process.poll() is not None]:
                running.remove(each)
                _close(each)
                if each.process.returncode == Busy.exit_code:
                    busy.append((time.monotonic() + RETRY_BUSY, each.job))
                else:
                    _conclude(each, runs, results, outcome, progress)
            time.sleep(POLL)
    finally:
        _end(running)
    return outcome


def _start(job: Job, runs: Path, results: Path) -> _Running:
    print(f"        {job.name}: {'resumed' if job.is_begun(runs) else 'started'}", flush=True)
    log = log_path(job, runs).open("ab")
    process = job.start(runs, results, log)
    return _Running(job, process, log, time.monotonic())


def _conclude(
    each: _Running, runs: Path, results: Path, outcome: Outcome, progress: Progress
) -> None:
    job, code = each.job, each.process.returncode
    if code == 0 and job.is_done(results):
        outcome.finished[job.name] = each.minutes
        progress.done(job, f"finished in {duration(each.minutes)}", each.minutes)
        return
    outcome.failed[job.name] = failure(code, log_path(job, runs))
    progress.done(job, f"failed, {outcome.failed[job.name]}")


def failure(code: int, log: Path) -> str:
    """Return why a job failed: its exit code, and the last line of its log."""
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    lines = [line for line in log.read_text("utf-8", "replace").splitlines() if line.strip()]
    return f"{how} ({log}): {lines[-1].strip() if lines else 'nothing in the log'}"


def log_path(job: Job, runs: Path) -> Path:
    """Return the file for what a job prints."""
    return runs / f"{job.name}.log"


def _end(running: Sequence[_Running]) -> None:
    for each in running:
        each.process.terminate()
    deadline = time.monotonic() + GRACE
    for each in running:
        try:
            each.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            each.process.kill()
            each.process.wait()
        _close(each)


def _close(each: _Running) -> None:
    each.log.close()
    assert each.process.stdin is not None
    each.process.stdin.close()


def duration(minutes: float) -> str:
    """Return a duration in words."""
    return f"{minutes / 60:.1f} h" if minutes >= 90 else f"{minutes:.1f} min"
