"""The page of the report: every table and figure, and what was not run."""

from __future__ import annotations

from collections.abc import Sequence

from cdcsr.tables import markdown
from training.study.report.beside_paper import Expected, seedless
from training.study.report.cells import Table
from training.study.report.records import Run
from training.study.report.table_parts import basis
from training.study.store import FOLLOW

TITLE = "# The study in numbers"
_READING = """\
How to read the tables. κ is the success rate; `0.76 [0.68, 0.83]` is the mean over seeds with its
range: a bootstrap interval over three seeds is their range, and covers the true mean in 68 to 76 %
of cases. No seed has demonstrations or targets of its own, so ranges say how much learning varies.
A star marks a single seed: its interval is Wilson's, over episodes, and says nothing about other
seeds. IQM is the interquartile mean over seeds (Agarwal et al. 2021); of fewer than four seeds it
is their mean. l_epi is the mean and standard deviation of the episode length over all episodes, in
simulation steps; a failure counts in full. Steps are those of all environments in training,
without the demonstrations and the clone's 100 episodes that BATD3 and CLASP begin with (some
16,000 steps); minutes are wall-clock minutes of training, the mean over seeds. Every number is
measured on held-out targets that nothing was tuned on, learning curves on validation targets.
`not run` stands where no finished run has measured anything."""


def page(
    runs: Sequence[Run],
    paper: Sequence[Table],
    tables: Sequence[Table],
    figures: Sequence[tuple[str, str]],
    expected: Expected | None,
) -> str:
    """Return the page in Markdown.

    Args:
        runs: the runs of the study.
        paper: the tables beside the paper's.
        tables: the other tables.
        figures: files and captions.
        expected: the runs of each experiment, if the study declares them.
    """
    parts = [TITLE, _provenance(runs), _READING, "## Beside the paper"]
    parts += [_section(table) for table in paper]
    parts += ["## Tables", *(_section(table) for table in tables), "## Figures"]
    parts += [
        f"![{file.removesuffix('.png')}]({file})\n\n{caption}" for file, caption in figures
    ] or ["No run has anything to draw yet."]
    parts += ["## What was not run", _missing(runs, expected)]
    return "\n\n".join(parts) + "\n"


def missing(runs: Sequence[Run], expected: Expected) -> dict[str, dict[str, list[str]]]:
    """Return what was expected and is missing: experiment, run, names of evaluations.

    A run that is not finished lacks all its evaluations.
    """
    have = {
        run.name: {*run.evaluations, *([FOLLOW] if run.follow is not None else [])} for run in runs
    }
    lacking = {
        experiment: {
            name: [one for one in wanted if one not in have.get(name, ())]
            for name, wanted in names.items()
        }
        for experiment, names in expected.items()
    }
    return {
        experiment: {name: lack for name, lack in names.items() if lack}
        for experiment, names in lacking.items()
    }


def _section(table: Table) -> str:
    body = table.markdown() if table.rows else "Not run."
    file = f"{table.name}.csv"
    return f"### {table.title}\n\n{table.note} As numbers: [{file}]({file}).\n\n{body}"


def _provenance(runs: Sequence[Run]) -> str:
    """Say where the numbers come from."""
    lines = ["Made by `python -m training.report` from the stored results. " + basis(runs)]
    robots = {run.fingerprint for run in runs}
    if len(robots) > 1:
        lines.append(
            f"**The runs are of {len(robots)} different robots**: {', '.join(sorted(robots))}."
        )
    versions: dict[str, set[str]] = {}
    for run in runs:
        for name, version in run.versions.items():
            versions.setdefault(name, set()).add(version)
    if versions:
        lines.append(
            "Versions: "
            + ", ".join(f"{k} {' and '.join(sorted(v))}" for k, v in sorted(versions.items()))
            + "."
        )
    return "\n".join(lines)


def _missing(runs: Sequence[Run], expected: Expected | None) -> str:
    if expected is None:
        return "The budget of the runs is unknown."
    rows = []
    have = {run.name for run in runs}
    for experiment, names in missing(runs, expected).items():
        total = len(expected[experiment])
        seeds: dict[str, int] = {}
        for name, lacking in names.items():
            what = f"`{seedless(name)}`" + (f": {', '.join(lacking)}" if name in have else "")
            seeds[what] = seeds.get(what, 0) + 1
        said = "; ".join(
            what + (f" ({count})" if count > 1 else "") for what, count in seeds.items()
        )
        rows.append([experiment, f"{total - len(names)} of {total}", said or "-"])
    return markdown(["experiment", "finished", "not run"], rows)
