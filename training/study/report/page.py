"""The page that sets the paper's printed numbers beside ours, and shows every table and figure of the study."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from cdcsr.tables import markdown
from training.algorithms.registry import algorithm_title
from training.study.report.cells import COST, Cell, Table, Value, cost, measure
from training.study.report.paper_numbers import DISTURBANCES, TABLE_2, TABLE_3, TABLE_4, Printed
from training.study.report.records import FOLLOW, SPACES, Run, at_home, grouped, is_plain
from training.study.report.table_parts import basis
from training.study.report.tables import disturbed

TITLE = "# The study in numbers"
ENGINE = "mujoco"
"""The paper's engine; only runs trained and tested in it stand beside the paper's."""
Expected = Mapping[str, Mapping[str, Sequence[str]]]
"""Of each experiment, its runs by name, and their evaluations that it needs."""
_HEAD = ("paper κ", "ours κ", "paper l_epi", "ours l_epi", "preset", *COST, "command")

_READING = """\
How to read it: κ is the success rate; `0.76 [0.68, 0.83]` is the mean over seeds with its 95 % percentile interval,
bootstrapped over seeds; an interval with a star comes from one seed and is Wilson's, over its episodes: it says
nothing about other seeds. Of three seeds an interval is about their range, and no seed has demonstrations or targets
of its own: intervals say how much the learning varies. IQM is the interquartile mean over seeds (Agarwal et al. 2021):
of fewer than four, their mean. l_epi is the mean and standard deviation of the episode length over all episodes, in
simulation steps, with failures counting in full. Steps are those of all environments together in training,
without the demonstrations, and the clone's 100 episodes that BATD3 and CLASP begin with (some 16,000 steps); minutes
are wall-clock time of training, the mean over seeds.
Every number is measured on held-out targets that nothing was tuned on; learning curves are on validation targets.
`not run` is what no finished run has measured."""


def beside_paper(runs: Sequence[Run], expected: Expected | None) -> Iterator[Table]:
    """Tables II, III and IV of the paper, a row for each of its cells and each preset of ours.

    Args:
        runs: of the study.
        expected: the runs of each experiment, to find the one that a run is from.
    """
    chosen = [run for run in runs if is_plain(run.setting) and run.setting.backend == ENGINE]
    expected = expected or {}
    batd3 = [run for run in chosen if run.setting.algorithm == "batd3"]

    rows: list[list[Value]] = []
    for (algorithm, space), printed in TABLE_2.items():
        own = [run for run in chosen if run.setting.algorithm == algorithm]
        cells = [
            measure(at_home(group, space), "nominal", space=space)
            for group in grouped(own, "space").values()
        ]
        rows += _rows(
            [algorithm_title(algorithm), SPACES[space]],
            printed,
            cells,
            ("table2", algorithm, space),
            expected,
        )
    yield _table("paper2", "Table II beside the paper", basis(chosen), ("algorithm", "space"), rows)

    rows = []
    for (source, space), printed in TABLE_3.items():
        groups = grouped(run for run in batd3 if run.setting.space == source)
        cells = [measure(group, "nominal", space=space) for group in groups.values()]
        rows += _rows(
            [SPACES[source], SPACES[space]], printed, cells, ("table3", "batd3", source), expected
        )
    yield _table(
        "paper3",
        "Table III beside the paper (BATD3)",
        basis(batd3),
        ("trained in", "tested in"),
        rows,
    )

    rows = []
    for (axis, level, space), printed in TABLE_4.items():
        groups = grouped(run for run in batd3 if run.setting.space == space)
        cells = [disturbed(group, axis, level, space) for group in groups.values()]
        rows += _rows(
            [DISTURBANCES[axis], level, SPACES[space]],
            printed,
            cells,
            ("table4", "batd3", space),
            expected,
        )
    yield _table(
        "paper4",
        "Table IV beside the paper (BATD3)",
        basis(batd3),
        ("what", "level", "space"),
        rows,
    )


def page(
    runs: Sequence[Run],
    paper: Sequence[Table],
    tables: Sequence[Table],
    figures: Sequence[tuple[str, str]],
    expected: Expected | None,
) -> str:
    """The page, in Markdown.

    Args:
        runs: of the study.
        paper: tables that stand beside the paper's.
        tables: the others.
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
    """What was expected and is not there, by experiment: the names of runs, with the evaluations that lack.

    Of a run that is not finished all lack.
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


def seedless(name: str) -> str:
    """A pattern that the names of a run's seeds fit."""
    return re.sub(r"_s\d+", "_s*", name)


def _section(table: Table) -> str:
    body = table.markdown() if table.rows else "Not run."
    return f"### {table.title}\n\n{table.note} As numbers: [{table.name}.csv]({table.name}.csv).\n\n{body}"


def _table(
    name: str, title: str, note: str, head: Sequence[str], rows: Sequence[Sequence[Value]]
) -> Table:
    return Table(name, title, note, (*head, *_HEAD), rows)


def _rows(
    names: list[Value],
    printed: Printed,
    cells: Sequence[Cell | None],
    source: tuple[str, str, str],
    expected: Expected,
) -> Iterator[list[Value]]:
    """A row for each of our cells; or one that says there is none."""
    printed_kappa, length = printed
    kappa = f"{printed_kappa:.2f}"
    found = [cell for cell in cells if cell]
    for cell in found:
        run = cell.runs[0]
        options = f"--budget {run.budget} " if run.budget else ""
        known = [name for name, names in expected.items() if run.name in names]
        if not known:  # of another budget
            known = [
                name
                for name, names in expected.items()
                if lengthless(run.name) in map(lengthless, names)
            ]
        experiment = source[0] if source[0] in known or not known else known[0]
        command = (
            f"`python -m training.experiments {experiment} {options}--only '{seedless(run.name)}'`"
        )
        yield [
            *names,
            kappa,
            cell.success,
            length,
            cell.length,
            run.setting.preset,
            *cost(cell.runs),
            command,
        ]
    if not found:
        experiment, algorithm, space = source
        command = f"`python -m training.experiments {experiment} --only '{algorithm}-*_{space}_{ENGINE}_*'`"
        yield [*names, kappa, None, length, None, "-", *cost(None), command]


def lengthless(name: str) -> str:
    """A run's name as that of runs of any length."""
    return re.sub(r"_u\d+", "_u*", name)


def _provenance(runs: Sequence[Run]) -> str:
    """Where the numbers come from."""
    lines = [
        "Made by `python -m training.report` from the CSV files of the study's finished runs. "
        + basis(runs)
    ]
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
        return "It is not known with which budget the runs were made."
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
