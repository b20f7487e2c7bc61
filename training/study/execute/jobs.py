"""One job of the study: train a run or go on with it, then make what is missing of its evaluations.

The executors run `python -m training.study.execute.jobs --job JSON`, a process for each job.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal, cast

from cdcsr.cli import run
from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import sealed, write_bytes, write_json
from cdcsr.leftovers import sweep
from cdcsr.locks import lock
from cdcsr.reading import MOST_TABLE, check_name, read_bytes
from training.config.run_description import RunDescription
from training.study.declare.budgets import Budget

if TYPE_CHECKING:
    from training.policy import Policy
    from training.run.train_options import Train
    from training.study.execute.evaluations import Subject

RECORD = "run.json"
"""This file is written last: with it the results of a run are complete."""
METRICS = "metrics.csv"
SUMMARY = "summary.json"
"""This file is in the folder of a training run once it is finished."""
ROBOT = "paper"


@dataclass(frozen=True)
class Job:
    """A run and the evaluations that are wanted of it."""

    spec: RunDescription
    evaluations: tuple[str, ...]
    budget: Budget

    def __post_init__(self) -> None:
        check_name("The name of a run", self.name)  # it becomes that of a folder

    @property
    def name(self) -> str:
        return self.spec.name

    def missing(self, results: Path) -> list[str]:
        """Return the evaluations that the working folder `results` still lacks."""
        from training.study.execute.evaluations import EVALUATIONS

        folder = results / self.name
        return [
            name
            for name in self.evaluations
            if name not in EVALUATIONS
            or not EVALUATIONS[name].is_done(folder / f"{name}.csv", self.budget.episodes)
        ]

    def is_done(self, results: Path) -> bool:
        """Return whether the working folder `results` lacks nothing."""
        return (results / self.name / RECORD).is_file() and not self.missing(results)

    def changed(self, results: Path) -> list[str]:
        """Return how the learner's numbers differ from those in a record of the working folder.

        Raises:
            CdcsrError: the record cannot be read.
        """
        from cdcsr.files import read_json

        path = results / self.name / RECORD
        return self.differences(read_json(path)) if path.is_file() else []

    def differences(self, record: Mapping[str, object]) -> list[str]:
        """Return how the learner's numbers differ from those in the record of a run."""
        from training.algorithms.registry import numbers_of

        if not self.spec.trains:
            return []
        recorded = cast(dict[str, object], record.get("learner", {}))
        now = numbers_of(self.spec)
        return [
            f"{name} {recorded[name]}, now {value}"
            for name, value in now.model_dump(mode="json").items()
            if name in recorded and recorded[name] != value
        ]

    def is_begun(self, runs: Path) -> bool:
        """Return whether its training has begun and not ended."""
        return (runs / self.name / "config.json").is_file() and not (
            runs / self.name / SUMMARY
        ).is_file()

    def training(self, out: Path, device: Literal["cpu", "cuda"] = "cpu") -> Train:
        """Return how its run is trained in a folder."""
        from training.run.train_options import train_options

        # At most 40 points on a learning curve, and as many checkpoints.
        every = max(self.budget.evaluate_every, self.spec.updates // 40)
        episodes = self.budget.validation_episodes
        options = train_options(self.spec, out, evaluate_every=every, evaluate_episodes=episodes)
        return replace(options, device=device)

    def command(self, runs: Path, results: Path) -> list[str]:
        """Return the command line of a process that does it; it ends with its standard input."""
        folders = ["--runs", os.path.realpath(runs), "--results", os.path.realpath(results)]
        return [
            sys.executable,
            "-m",
            "training.study.execute.jobs",
            "--job",
            self.to_json(),
            *folders,
            "--until-stdin-ends",
        ]

    def start(self, runs: Path, results: Path, log: IO[bytes]) -> subprocess.Popen[bytes]:
        """Start a process that does it; both outputs go to `log`. Ctrl-C does not reach it."""
        return subprocess.Popen(
            self.command(runs, results),
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment(),
            start_new_session=True,
        )

    def to_json(self) -> str:
        """Return one line that :meth:`from_json` reads."""
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
    """Return the environment of a job's process: one thread, and no progress bar in its log."""
    threads = dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
    )
    return {**os.environ, **threads, "TQDM_DISABLE": "1", "PYTHONUNBUFFERED": "1"}


def carry_out(job: Job, runs: Path, results: Path) -> None:
    """Do what is left of a job. It may be killed at any moment and started again.

    Args:
        job: what is wanted.
        runs: folder of the training runs and their locks.
        results: working folder of the results.

    Raises:
        Busy: another process works on it.
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
    from controllers.registry import SCRIPTED
    from training.study.execute.evaluations import EVALUATIONS, Subject

    torch.set_num_threads(1)
    spec, card = job.spec, {}
    sweep(folder)
    if spec.trains:
        finished = (out / SUMMARY).is_file()
        policy = _train(job, out)
        subject, card = Subject(spec, policy, policy.robot), policy.card
        if not _is_of(folder, policy.digest, finished):
            there = [name for name in EVALUATIONS if (folder / f"{name}.csv").is_file()]
            missing = list(dict.fromkeys((*there, *missing)))
            for name in there:
                (folder / f"{name}.csv").unlink()
            # Last: while the record is there, the folder is known to be of another policy.
            (folder / RECORD).unlink(missing_ok=True)
        if (out / METRICS).is_file():  # the behaviour clone alone has no learning curve
            write_bytes(folder / METRICS, read_bytes(out / METRICS, MOST_TABLE, "metrics"))
    else:
        robot = load_robot(ROBOT)
        subject = Subject(spec, SCRIPTED[spec.algorithm](robot), robot)
    for name in missing:
        print(f"{job.name}: {name}", flush=True)
        EVALUATIONS[name].write(folder / f"{name}.csv", subject, job.budget.episodes)
    write_json(folder / RECORD, sealed(_record(job, subject, card)))


def _is_of(folder: Path, digest: str, finished: bool) -> bool:
    """Return whether the results in a folder are those of this policy.

    All results of a run must be of one policy. Where results were copied from another machine
    without the policy, training again gives a slightly different one, as processors round
    differently.

    Args:
        folder: the results of the run.
        digest: the digest of the policy.
        finished: the policy was there before, and was not trained just now.
    """
    from cdcsr.files import read_json

    path = folder / RECORD
    return read_json(path).get("policy") == digest if path.is_file() else finished


def _train(job: Job, out: Path) -> Policy:
    """Return the policy of the run, trained as far as that is still to be done.

    Raises:
        CdcsrError: a run with other options is there, or one that only a GPU can go on with.
    """
    from cdcsr.files import read_json
    from training.policy import load_policy
    from training.run.train_options import RUN_FOLDER
    from training.run.trainer import train

    record = out / RUN_FOLDER.record
    if record.is_file() and read_json(record).get("device", "cpu") != "cpu":
        if (out / SUMMARY).is_file():
            return load_policy(out)
        raise CdcsrError(f"{out} was begun with --executor gpu; go on with that, or delete it.")
    return train(job.training(out))


def _record(job: Job, subject: Subject, card: Mapping[str, object]) -> dict[str, object]:
    from training.algorithms.registry import numbers_of
    from training.policy import versions

    return {
        "spec": {**job.spec.as_dict(), "budget": job.budget.name},
        "learner": numbers_of(job.spec).model_dump(mode="json") if job.spec.trains else {},
        "policy": getattr(subject.controller, "digest", None),
        "commit": commit(),
        "minutes": card.get("minutes", 0.0),
        "updates": card.get("updates", 0),
        "environment_steps": card.get("environment_steps", 0),
        **({"device": card["device"]} if card.get("device", "cpu") != "cpu" else {}),
        "versions": card.get("versions") or versions(),
        "robot": subject.robot.name,
        "fingerprint": subject.robot.fingerprint,
    }


def commit() -> str:
    """Return the commit of the checkout that the code runs from, or the installed version."""
    folder = Path(__file__).parents[3]
    if (folder / ".git").exists():
        command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError):
            pass
        else:
            return done.stdout.strip()
    return version("cdcsr")


def do_job(
    *,
    job: str,
    runs: Path = Path("runs/study"),
    results: Path = Path("runs/results"),
    until_stdin_ends: bool = False,
) -> None:
    """Do one job of the study.

    Args:
        job: the text that :meth:`Job.to_json` returned.
        runs: folder of the training runs.
        results: working folder of the results.
        until_stdin_ends: end at once when standard input ends, as when the executor has died.
    """
    if until_stdin_ends:
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    carry_out(Job.from_json(job), runs, results)


def _end_with_stdin() -> None:
    while os.read(0, 1024):
        pass
    os._exit(1)  # at once, as if killed, which loses nothing


def main() -> int:
    """Do one job from the command line."""
    return run(do_job, "training.study.execute.jobs", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
