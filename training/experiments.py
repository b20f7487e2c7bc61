"""`python -m training.experiments`: the study, as experiments that can be stopped and resumed."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cdcsr.cli import run

if TYPE_CHECKING:
    from training.study.declare.budgets import Budget
    from training.study.execute.jobs import Job
    from training.study.execute.local import Outcome
    from training.study.store import StoredRun


def experiments(
    names: tuple[str, ...] = (),
    /,
    *,
    budget: Literal["quick", "standard", "paper"] = "standard",
    jobs: int | None = None,
    executor: Literal["local", "ray", "gpu"] = "local",
    address: str | None = None,
    runs: Path = Path("runs/study"),
    results: Path = Path("runs/results"),
    store: Path = Path("results"),
    only: str = "*",
    list: bool = False,
    pack: bool = False,
    shipped: bool = False,
    json: Path | None = None,
) -> None:
    """Run experiments: grids of training runs and their evaluations, each run in its own process.

    Finished runs are skipped, and a run that several experiments need is trained once. However the
    command is stopped, the same command resumes the work; a run loses at most the work since the
    last point of its learning curve. On a GPU some points may be lost: those of the last minute.

    Args:
        names: experiments, or "all"; --list shows them.
        budget: quick is a smoke test; paper has the lengths and seeds of the paper.
        jobs: runs side by side on this machine; by default as many as it has processors.
        executor: ray spreads the runs over a Ray cluster whose nodes share the folders; gpu trains
            the seeds and spaces of a method side by side on a GPU, then evaluates as local.
        address: address of that cluster; by default a new one is started on this machine.
        runs: folder of the training runs, with their logs and weights.
        results: working folder of the results, a few small files a run.
        store: folder of the packed results; runs that are finished there are not made again.
        only: do only the runs whose names fit this pattern, such as "batd3-*_s0".
        list: show what would be done, and do nothing.
        pack: move the finished runs of the working folder into the store, and do nothing else.
        shipped: measure the shipped policies in every engine and space into the store, write the
            results into their cards, and do nothing else.
        json: also write to this file what became of each run.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import refuse_unwritable, write_json
    from training.study import store as results_store
    from training.study.declare.budgets import BUDGETS

    if pack:
        print(f"{results_store.pack(results, store)} runs packed from {results} into {store}")
        return
    if shipped:
        _measure_shipped(store)
        return
    chosen = _chosen(names, list, executor, address, jobs)
    amounts = BUDGETS[budget]
    stored = results_store.read_store(store)
    wanted = _jobs(chosen, amounts, only)
    if list:
        _show(chosen, wanted, amounts, results, stored, named=bool(names))
        return
    if not wanted:
        raise CdcsrError(
            f"No run of {', '.join(chosen)} fits the pattern {only!r}; --list shows their names."
        )
    for folder in (runs, results):
        refuse_unwritable(folder / "run.json")
    _refuse_other_learners(wanted, results, runs, store, stored)
    left = [
        replace(job, evaluations=lacking)
        for job in wanted
        if (lacking := _lacking(job, stored)) or job.name not in stored
    ]
    outcome = _carry_out(left, runs, results, jobs, executor, address)
    names_left = {job.name for job in left}
    outcome.skipped[:0] = [job.name for job in wanted if job.name not in names_left]
    if json is not None:
        write_json(json, {"experiments": chosen, "budget": budget, **vars(outcome)})
    _conclude(outcome, len(wanted))


def _measure_shipped(store: Path) -> None:
    from training.policy import shipped_policies
    from training.study.execute.shipped import measure_shipped
    from training.study.report.shipped_policies import write_card

    print(f"{measure_shipped(store)} cells measured into {store}")
    for folder in shipped_policies().values():
        write_card(folder, store)


def _conclude(outcome: Outcome, wanted: int) -> None:
    """Say what became of the runs.

    Raises:
        CheckFailed: a run failed.
    """
    from cdcsr.errors import CheckFailed

    finished, skipped, failed = map(len, (outcome.finished, outcome.skipped, outcome.failed))
    print(f"{finished} runs finished, {skipped} done before, {failed} failed")
    if outcome.failed:
        name, why = next(iter(outcome.failed.items()))
        raise CheckFailed(f"{failed} of {wanted} runs failed, first: {name}: {why}")


def _chosen(
    names: Sequence[str], listed: bool, executor: str, address: str | None, jobs: int | None
) -> Sequence[str]:
    """Return the experiments that are meant; refuse options that do not fit together."""
    from cdcsr.errors import CdcsrError, unknown_choice
    from training.study.declare.grid import EXPERIMENTS

    if not names and not listed:
        raise CdcsrError(f"No experiment is given; name some of: {', '.join(EXPERIMENTS)}; or all.")
    for name in names:
        if name not in (*EXPERIMENTS, "all"):
            raise CdcsrError(unknown_choice("experiment", name, (*EXPERIMENTS, "all")))
    if address is not None and executor != "ray":
        raise CdcsrError("--address names a Ray cluster; give --executor ray with it.")
    if jobs is not None and executor == "ray":
        raise CdcsrError(
            "--jobs is for this machine; a Ray cluster has as many runs side by side as processors."
        )
    return tuple(EXPERIMENTS) if not names or "all" in names else names


def _jobs(chosen: Sequence[str], budget: Budget, only: str) -> list[Job]:
    from training.study.declare.grid import collect
    from training.study.execute.jobs import Job

    return [
        Job(spec, evaluations, budget)
        for name, (spec, evaluations) in collect(chosen, budget).items()
        if fnmatch(name, only)
    ]


def _refuse_other_learners(
    wanted: Sequence[Job], results: Path, runs: Path, store: Path, stored: dict[str, StoredRun]
) -> None:
    """Check that what is there was made with the same numbers of the learner."""
    from cdcsr.errors import CdcsrError

    for job in wanted:
        if changed := job.changed(results):
            raise CdcsrError(
                f"{results / job.name} was made with other numbers of the learner "
                f"({'; '.join(changed)}); delete it and {runs / job.name} to make it again, or "
                "give other folders (--results, --runs)."
            )
        known = stored.get(job.name)
        if known is not None and (changed := job.differences(known.record)):
            raise CdcsrError(
                f"{store} has {job.name} with other numbers of the learner ({'; '.join(changed)}); "
                "give another --store."
            )


def _lacking(job: Job, stored: dict[str, StoredRun]) -> tuple[str, ...]:
    """Return the evaluations of a job that the store lacks."""
    from training.study.execute.evaluations import EVALUATIONS

    known = stored.get(job.name)
    return tuple(
        name
        for name in job.evaluations
        if known is None or known.episodes(name) < EVALUATIONS[name].episodes(job.budget.episodes)
    )


def _carry_out(
    wanted: Sequence[Job],
    runs: Path,
    results: Path,
    jobs: int | None,
    executor: str,
    address: str | None,
) -> Outcome:
    from training.study.execute.local import carry_out_here
    from training.study.execute.ray_executor import carry_out_on_ray

    if executor == "ray":
        return carry_out_on_ray(wanted, runs, results, address)
    slots = (os.cpu_count() or 1) if jobs is None else jobs
    if executor == "gpu":
        import torch

        from training.study.execute.gpu_executor import carry_out_on_gpu

        return carry_out_on_gpu(wanted, runs, results, slots, torch.device("cuda"))
    return carry_out_here(wanted, runs, results, slots)


def _show(
    chosen: Sequence[str],
    wanted: Sequence[Job],
    budget: Budget,
    results: Path,
    stored: dict[str, StoredRun],
    named: bool,
) -> None:
    """Print the experiments, and the runs of those that were named."""
    from training.study.declare.grid import EXPERIMENTS, collect
    from training.study.execute.jobs import Job

    def is_done(job: Job) -> bool:
        return (job.name in stored and not _lacking(job, stored)) or job.is_done(results)

    for name in chosen:
        cells = collect([name], budget)
        own = [Job(*cells[job.name], budget) for job in wanted if job.name in cells]
        done = sum(map(is_done, own))
        print(f"{name:<13} {EXPERIMENTS[name].summary} ({done} of {len(own)} runs done)")
    if named:
        for job in wanted:
            print(f"  {'done' if is_done(job) else '-':<5} {job.name}")


def main() -> int:
    """Run experiments from the command line."""
    return run(experiments, "training.experiments", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
