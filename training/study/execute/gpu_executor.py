"""Do jobs with a GPU: runs that share all shapes are trained side by side on it.

Those are runs that differ only in their seeds, and in spaces whose demonstrations are the same.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from cdcsr.errors import CdcsrError
from cdcsr.leftovers import make_folder
from cdcsr.locks import Busy
from cdcsr.tasks.spaces import demonstration_space
from training.config.run_description import RunDescription
from training.run.device_parts import NotOnDevice
from training.run.device_run import train_side_by_side
from training.study.declare.budgets import Budget
from training.study.execute.jobs import SUMMARY, Job
from training.study.execute.local import Outcome, carry_out_here, duration


def carry_out_on_gpu(
    jobs: Sequence[Job], runs: Path, results: Path, slots: int, device: torch.device
) -> Outcome:
    """Train on a GPU what is not trained yet, then evaluate in processes of this machine.

    A run that fails does not stop the others. What only a processor can train, and what another
    process is at, is left to the processes.

    Args:
        jobs: the jobs.
        runs: folder of the training runs.
        results: working folder of the results.
        slots: how many evaluations run at once.
        device: where the learners are.

    Raises:
        CdcsrError: there is no such device, or the folder `runs` cannot be made.
    """
    if device.type == "cuda" and not torch.cuda.is_available():
        raise CdcsrError("PyTorch finds no GPU for --executor gpu here; choose local.")
    try:
        make_folder(runs)
    except OSError as error:
        raise CdcsrError(f"Cannot make the folder {runs}: {error.strerror}.") from None
    groups, failed = side_by_side(jobs, runs, results), dict[str, str]()
    for number, group in enumerate(groups, 1):
        more = f" and {len(group) - 1} beside it" if len(group) > 1 else ""
        what = f"[{number}/{len(groups)}] {group[0].name}{more}"
        print(f"{what}: started", flush=True)
        started = time.monotonic()
        if wrong := _train(group, runs, device):
            failed |= wrong
            print(f"{what}: {len(wrong)} failed, first: {next(iter(wrong.values()))}", flush=True)
            continue
        if all((runs / job.name / SUMMARY).is_file() for job in group):
            minutes = (time.monotonic() - started) / 60
            print(f"{what}: trained in {duration(minutes)}", flush=True)
    outcome = carry_out_here([job for job in jobs if job.name not in failed], runs, results, slots)
    outcome.failed |= failed
    return outcome


def _train(group: list[Job], runs: Path, device: torch.device) -> dict[str, str]:
    """Train runs together or, if that fails, each alone; return those that failed, and why."""
    try:
        train_side_by_side([job.training(runs / job.name, "cuda") for job in group], device)
    except (NotOnDevice, Busy) as error:
        if len(group) == 1:
            print(f"        {group[0].name}: left to the processors, {error}", flush=True)
            return {}
    except (CdcsrError, RuntimeError) as error:  # PyTorch's errors of a GPU are the latter
        if len(group) == 1:
            return {group[0].name: str(error).split("\n")[0]}
    else:
        return {}
    failed: dict[str, str] = {}
    for job in group:
        failed |= _train([job], runs, device)
    return failed


def side_by_side(jobs: Sequence[Job], runs: Path, results: Path) -> list[list[Job]]:
    """Return the jobs that are still to be trained; those in a list are trained together."""
    groups: dict[tuple[RunDescription, Budget], list[Job]] = {}
    for job in jobs:
        trained = (runs / job.name / SUMMARY).is_file() or job.is_done(results)
        if job.spec.trains and not trained:
            # A radius is that of the balls of one space.
            space = job.spec.space if job.spec.radius else demonstration_space(job.spec.space)
            alike = replace(job.spec, seed=0, space=space)
            groups.setdefault((alike, job.budget), []).append(job)
    return list(groups.values())
