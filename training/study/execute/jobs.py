"""One job of the study: train a run or go on with it, then make what is missing of its evaluations.

`python -m training.study.execute.jobs --job JSON` does one job in a process of its own, as the executors do.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cdcsr.cli import run
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import write_bytes, write_json
from cdcsr.locks import lock
from training.config.run_description import RunDescription
from training.study.declare.budgets import Budget

if TYPE_CHECKING:
    from training.policy import Policy

RECORD = "run.json"
"""Written last: a run whose record is there has a policy, and a learning curve if it learns."""
METRICS = "metrics.csv"
SUMMARY = "summary.json"
"""Of a run's folder: there once it is finished."""
ROBOT = "paper"


@dataclass(frozen=True)
class Job:
    """A run and what is wanted of it."""

    spec: RunDescription
    evaluations: tuple[str, ...]
    budget: Budget

    @property
    def name(self) -> str:
        return self.spec.name

    def missing(self, results: Path) -> list[str]:
        """The evaluations that are still to be made."""
        from training.study.execute.evaluations import EVALUATIONS

        folder = results / self.name
        return [
            name
            for name in self.evaluations
            if name not in EVALUATIONS
            or not EVALUATIONS[name].is_done(folder / f"{name}.csv", self.budget.episodes)
        ]

    def is_done(self, results: Path) -> bool:
        """Whether nothing is left to do."""
        return (results / self.name / RECORD).is_file() and not self.missing(results)

    def changed(self, results: Path) -> list[str]:
        """Numbers of the learner that the results there were made with, and that are others now.

        Raises:
            CdcsrError: the record cannot be read.
        """
        from cdcsr.files import read_json
        from training.algorithms.registry import numbers_of

        path = results / self.name / RECORD
        if not path.is_file() or not self.spec.trains:
            return []
        recorded, now = read_json(path).get("learner", {}), numbers_of(self.spec)
        return [
            f"{name} {recorded[name]}, now {value}"
            for name, value in now.model_dump(mode="json").items()
            if name in recorded and recorded[name] != value
        ]

    def is_begun(self, runs: Path) -> bool:
        """Whether its training has begun, and not ended."""
        return (runs / self.name / "config.json").is_file() and not (
            runs / self.name / SUMMARY
        ).is_file()

    def command(self, runs: Path, results: Path) -> list[str]:
        """The command line of a process that does it, and ends when its standard input does."""
        folders = ["--runs", str(runs.resolve()), "--results", str(results.resolve())]
        return [
            sys.executable,
            "-m",
            "training.study.execute.jobs",
            "--job",
            self.to_json(),
            *folders,
            "--until-stdin-ends",
        ]

    def to_json(self) -> str:
        """One line that :meth:`from_json` reads."""
        data = {
            "spec": self.spec.as_dict(),
            "evaluations": self.evaluations,
            "budget": asdict(self.budget),
        }
        return json.dumps(data)

    @classmethod
    def from_json(cls, text: str) -> Job:
        """Read what :meth:`to_json` wrote.

        Raises:
            CdcsrError: it is something else.
        """
        try:
            data = json.loads(text)
            spec = RunDescription.from_dict(data["spec"])
            return cls(spec, tuple(data["evaluations"]), Budget(**data["budget"]))
        except (ValueError, TypeError, KeyError) as error:
            raise CdcsrError(f"{text!r} is not a job of the study: {error}.") from None


def environment() -> dict[str, str]:
    """The environment of a job's process: one thread, and no progress bar in its log."""
    threads = dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
    )
    return {**os.environ, **threads, "TQDM_DISABLE": "1", "PYTHONUNBUFFERED": "1"}


def carry_out(job: Job, runs: Path, results: Path) -> None:
    """Do what is left of a job, and nothing twice. It may be killed at any moment, and done again.

    Args:
        job: what is wanted.
        runs: where its training run is, by its name; also its lock.
        results: where its results go, by its name.

    Raises:
        Busy: another process is at it.
        CdcsrError: there is no such algorithm or evaluation.
    """
    from training.algorithms.registry import find_algorithm
    from training.study.execute.evaluations import EVALUATIONS

    for name in job.evaluations:
        if name not in EVALUATIONS:
            raise CdcsrError(unknown_choice("evaluation", name, EVALUATIONS))
    if job.spec.trains:
        find_algorithm(job.spec.algorithm)
    with lock(runs / f"{job.name}.lock"):
        missing = job.missing(results)
        if job.is_done(results):
            print(f"{job.name}: done before", flush=True)
            return
        _work(job, missing, runs / job.name, results / job.name)


def _work(job: Job, missing: list[str], out: Path, folder: Path) -> None:
    import torch

    from cdcsr.robot.description import load_robot
    from controllers.jacobian import JacobianController
    from training.study.execute.evaluations import EVALUATIONS, Subject

    torch.set_num_threads(1)
    spec, card = job.spec, {}
    _sweep(folder)
    if spec.trains:
        finished = (out / SUMMARY).is_file()
        policy = _train(job, out)
        subject, card = Subject(spec, policy, policy.robot), policy.card
        if not _is_of(folder, policy.digest, finished):
            there = [name for name in EVALUATIONS if (folder / f"{name}.csv").is_file()]
            missing = list(dict.fromkeys((*there, *missing)))
            for name in there:
                (folder / f"{name}.csv").unlink()
            (folder / RECORD).unlink(
                missing_ok=True
            )  # last: as long as it is there, it is seen that it is another's
        if (out / METRICS).is_file():  # the behaviour clone alone has no learning curve
            write_bytes(folder / METRICS, (out / METRICS).read_bytes())
    else:
        robot = load_robot(ROBOT)
        subject = Subject(spec, JacobianController(robot), robot)
    for name in missing:
        print(f"{job.name}: {name}", flush=True)
        EVALUATIONS[name].write(folder / f"{name}.csv", subject, job.budget.episodes)
    write_json(folder / RECORD, _record(job, subject, card))


def _is_of(folder: Path, digest: str, finished: bool) -> bool:
    """Whether the results there are of this policy. A run's results are of one policy, or they are made again.

    Results go from machine to machine and policies do not; where only the results are, a policy that is trained for
    another evaluation is not quite the one they are of, as processors round differently.

    Args:
        folder: of the run's results.
        digest: of the policy.
        finished: it was there, not trained just now.
    """
    from cdcsr.files import read_json

    path = folder / RECORD
    return read_json(path).get("policy") == digest if path.is_file() else finished


def _train(job: Job, out: Path) -> Policy:
    """Return the policy of the run, trained as far as that is still to be done.

    Raises:
        CdcsrError: a run with other options is there.
    """
    from training.run.train_options import train_options
    from training.run.trainer import train

    # At most 40 points on a learning curve, and as many checkpoints.
    every = max(job.budget.evaluate_every, job.spec.updates // 40)
    episodes = job.budget.validation_episodes
    return train(train_options(job.spec, out, evaluate_every=every, evaluate_episodes=episodes))


def _sweep(folder: Path) -> None:
    """Remove what a process that was killed had not finished writing."""
    for path in folder.glob(".*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def _record(job: Job, subject: Any, card: dict[str, Any]) -> dict[str, Any]:
    from training.algorithms.registry import numbers_of
    from training.policy import versions

    return {
        "spec": {**job.spec.as_dict(), "budget": job.budget.name},
        "learner": numbers_of(job.spec).model_dump(mode="json") if job.spec.trains else {},
        "policy": subject.controller.digest if job.spec.trains else None,
        "minutes": card.get("minutes", 0.0),
        "updates": card.get("updates", 0),
        "environment_steps": card.get("environment_steps", 0),
        "versions": card.get("versions") or versions(),
        "robot": subject.robot.name,
        "fingerprint": subject.robot.fingerprint,
    }


def do_job(
    *,
    job: str,
    runs: Path = Path("runs/study"),
    results: Path = Path("results/study"),
    until_stdin_ends: bool = False,
) -> None:
    """Do one job of the study.

    Args:
        job: what :meth:`Job.to_json` wrote.
        runs: folder of the training runs.
        results: folder of the results.
        until_stdin_ends: end at once when standard input does: when the process that writes to it has died.
    """
    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM)
    )  # gives its lock back on the way out
    if until_stdin_ends:
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    carry_out(Job.from_json(job), runs, results)


def _end_with_stdin() -> None:
    while os.read(0, 1024):
        pass
    os._exit(1)  # at once, as if killed: nothing is lost by that


def main() -> int:
    """Do one job from the command line."""
    return run(do_job, "training.study.execute.jobs", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
