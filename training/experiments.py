"""`python -m training.experiments`: the paper's tables and figures, and what goes beyond, as one resumable study."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Literal

from cdcsr.cli import run


def experiments(
    names: tuple[str, ...] = (),
    /,
    *,
    budget: Literal["quick", "standard", "paper"] = "standard",
    jobs: int | None = None,
    resume: bool = False,
    executor: Literal["local", "ray"] = "local",
    address: str | None = None,
    runs: Path = Path("runs/study"),
    results: Path = Path("results/study"),
    only: str = "*",
    list: bool = False,
    json: Path | None = None,
) -> None:
    """Carry out experiments: grids of training runs and their evaluations, each run in a process of its own.

    What is finished is skipped, and a run that several experiments need is trained once. Stopped in any way, the
    same command with --resume goes on; a run loses at most what came after its last point of the learning curve.

    Args:
        names: experiments, or "all"; --list shows them.
        budget: quick is a smoke test, paper the lengths and seeds of the paper.
        jobs: runs side by side on this machine; by default as many as it has processors.
        resume: go on with runs that were begun and not finished.
        executor: ray spreads the runs over a Ray cluster whose nodes share the folders.
        address: of that cluster; by default a new one on this machine.
        runs: folder of the training runs, with their logs and weights.
        results: folder of the results.
        only: do only runs whose name fits this pattern, as in "batd3-*_s0".
        list: show what would be done, and do nothing.
        json: also write what became of each run to this file.
    """
    from cdcsr.errors import CdcsrError, CheckFailed, unknown_choice
    from cdcsr.files import write_json
    from training.study.declare.budgets import BUDGETS
    from training.study.declare.grid import EXPERIMENTS, collect
    from training.study.execute.jobs import Job

    if not names and not list:
        raise CdcsrError(f"No experiment is given; name some of: {', '.join(EXPERIMENTS)}; or all.")
    if address is not None and executor != "ray":
        raise CdcsrError("--address is that of a Ray cluster; give --executor ray with it.")
    for name in names:
        if name not in (*EXPERIMENTS, "all"):
            raise CdcsrError(unknown_choice("experiment", name, (*EXPERIMENTS, "all")))
    chosen = [*EXPERIMENTS] if not names or "all" in names else names
    if jobs is not None and executor == "ray":
        raise CdcsrError(
            "--jobs is for this machine; a Ray cluster has as many runs side by side as processors."
        )
    amounts = BUDGETS[budget]
    wanted = [
        Job(spec, evaluations, amounts)
        for name, (spec, evaluations) in collect(chosen, amounts).items()
        if fnmatch(name, only)
    ]
    if list:
        _show(chosen, wanted, amounts, results, named=bool(names))
        return
    if not wanted:
        raise CdcsrError(
            f"No run of {', '.join(chosen)} fits the pattern {only!r}; --list shows their names."
        )
    if not resume and (begun := [job.name for job in wanted if job.is_begun(runs)]):
        raise CdcsrError(
            f"{len(begun)} runs in {runs} were begun and not finished, the first is {begun[0]}; "
            "give --resume to go on with them, or delete their folders."
        )
    for job in wanted:
        if changed := job.changed(results):
            raise CdcsrError(
                f"{results / job.name} was made with other numbers of the learner ({'; '.join(changed)}); "
                f"delete it and {runs / job.name} to have it made again, or give other folders (--results, --runs)."
            )
    if executor == "ray":
        from training.study.execute.ray_executor import carry_out_on_ray

        outcome = carry_out_on_ray(wanted, runs, results, address)
    else:
        from training.study.execute.local import carry_out_here

        outcome = carry_out_here(
            wanted, runs, results, (os.cpu_count() or 1) if jobs is None else jobs
        )
    print(
        f"{len(outcome.finished)} runs finished, {len(outcome.skipped)} done before, {len(outcome.failed)} failed"
    )
    if json is not None:
        write_json(json, {"experiments": chosen, "budget": budget, **vars(outcome)})
    if outcome.failed:
        name, why = next(iter(outcome.failed.items()))
        raise CheckFailed(
            f"{len(outcome.failed)} of {len(wanted)} runs failed, first: {name}: {why}"
        )


def _show(
    chosen: Sequence[str], wanted: list[Any], budget: Any, results: Path, named: bool
) -> None:
    """Print the experiments, or the runs of those that were named."""
    from training.study.declare.grid import EXPERIMENTS, collect
    from training.study.execute.jobs import Job

    for name in chosen:
        cells = collect([name], budget)
        own = [Job(*cells[job.name], budget) for job in wanted if job.name in cells]
        done = sum(job.is_done(results) for job in own)
        print(f"{name:<13} {EXPERIMENTS[name].summary} ({done} of {len(own)} runs done)")
    if named:
        for job in wanted:
            print(f"  {'done' if job.is_done(results) else '-':<5} {job.name}")


def main() -> int:
    """Carry out experiments from the command line."""
    return run(experiments, "training.experiments", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
