"""The study's tables: those of the paper, and those that go past it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cdcsr.simulation.engines import backend_names, engine_title
from training.algorithms.registry import algorithm_title
from training.measure.plant_axes import AXES, Axis
from training.measure.statistics import Sweep, disagreement, halving, rate
from training.study.declare.grid import ABLATIONS, AROUND, COUNTS
from training.study.declare.learner_changes import GENERAL, OURS, PUT_BACK, RAISED
from training.study.report.cells import (
    COST,
    TRAINED,
    Cell,
    Table,
    Value,
    amount,
    cost,
    measure,
    trained,
)
from training.study.report.paper_numbers import DISTURBANCES, TABLE_4
from training.study.report.plant_sweeps import sweeps
from training.study.report.records import (
    DEMONSTRATIONS,
    JACOBIAN,
    SPACES,
    Episodes,
    Run,
    at_home,
    grouped,
    is_of_paper,
    is_plain,
    is_usual,
)

COMPARED = ("bc", "batd3", OURS, "td3wd", "rbl", "td3", "her", "rlpd", "drldr", JACOBIAN)
"""Rows of Table II, run or not."""
COUNTED = ("batd3", OURS, "td3wd", "bc")
"""Algorithms whose number of demonstrations varies."""
ANYBODY = "any run"
"""Stands where an algorithm would, in the row of what at least one run reaches."""
ALL_COUNTS = tuple(sorted((*COUNTS, DEMONSTRATIONS)))
SIDES: tuple[Literal["below", "above"], ...] = ("below", "above")
_GENERAL, _PUT_BACK, _RAISED = (
    [tuple(sorted(changes)) for changes in several] for several in (GENERAL, PUT_BACK, RAISED)
)
_RESULT = ("κ", "IQM of κ", "l_epi")


def comparison(runs: Sequence[Run]) -> Table:
    """Table II: every algorithm in the space and engine it was trained in."""
    chosen = [run for run in runs if is_plain(run.setting)]
    rows = [row for space in SPACES for row in _home_rows(chosen, space, COMPARED)]
    return Table(
        "table2", "Table II: comparison", basis(chosen), ("space", *TRAINED, *_RESULT, *COST), rows
    )


def ablation(runs: Sequence[Run]) -> Table:
    """Fig. 4 in numbers: BATD3 without each of its parts."""
    chosen = [run for run in runs if is_plain(run.setting) and run.setting.algorithm in ABLATIONS]
    rows = [row for space in SPACES for row in _home_rows(chosen, space, ABLATIONS)]
    note = f"{basis(chosen)} Without ensemble, the preset `paper` has TD3's two critics left, and `tuned` a single one."
    return Table("ablation", "Ablations of BATD3", note, ("space", *TRAINED, *_RESULT, *COST), rows)


def own_ablation(runs: Sequence[Run]) -> Table:
    """Methods with single numbers of their learners changed, in the spaces where that was done."""
    chosen = variants(runs)
    rows = [row for space in SPACES for row in _home_rows(chosen, space, ())]
    title = f"Variants of {algorithm_title(OURS)} and of the others"
    return Table("ours", title, basis(chosen), ("space", *TRAINED, *_RESULT, *COST), rows)


def variants(runs: Iterable[Run]) -> list[Run]:
    """Runs with switches in the paper's spaces, and those of the same algorithm there without."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "tuned"]
    # What is for every method Table III has; what is put back has a table of its own.
    own = [run for run in own if run.setting.changes not in _GENERAL]
    own = [
        run for run in own if run.setting.algorithm == OURS or run.setting.changes not in _PUT_BACK
    ]
    varied = {(run.setting.algorithm, run.setting.space) for run in own if run.setting.changes}
    return [run for run in own if (run.setting.algorithm, run.setting.space) in varied]


def presets(runs: Sequence[Run]) -> Table:
    """What the preset `tuned` changes, one number after another put back to the paper's."""
    put_back = {
        run.setting for run in runs if is_usual(run.setting) and run.setting.changes in _PUT_BACK
    }
    put_back = {setting for setting in put_back if setting.algorithm != OURS}
    shown = put_back | {replace(setting, changes=()) for setting in put_back}
    chosen = [run for run in runs if run.setting in shown]
    rows = [row for space in SPACES for row in _home_rows(chosen, space, ())]
    title = "The preset `tuned` with one number put back to the paper's"
    return Table("preset", title, basis(chosen), ("space", *TRAINED, *_RESULT, *COST), rows)


def raised(runs: Sequence[Run]) -> Table:
    """The paper's preset with numbers of the preset `tuned`, few first."""
    own = [run for run in runs if is_usual(run.setting) and run.setting.preset == "paper-reading"]
    spaces = {run.setting.space for run in own if run.setting.changes in _RAISED}
    chosen, rows = [], []
    for space, switches in product((space for space in SPACES if space in spaces), ((), *_RAISED)):
        some = [
            run
            for run in own
            if (run.setting.algorithm, run.setting.changes) == ("batd3", switches)
        ]
        chosen += at_home(some, space)
        rows += _home_rows(at_home(some, space), space, ())
    title = "The paper's preset with numbers of the preset `tuned`"
    return Table("raised", title, basis(chosen), ("space", *TRAINED, *_RESULT, *COST), rows)


def demonstrations(runs: Sequence[Run]) -> Table:
    """Fig. 5 in numbers: success by the number of demonstrations, in Anchor Space."""
    chosen = counted(runs)
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        rows.append(
            [
                setting.num_demonstrations,
                *trained(setting),
                *_result(group, space="anchor"),
                *cost(group),
            ]
        )
    have = {(run.setting.algorithm, run.setting.num_demonstrations) for run in chosen}
    for algorithm in COUNTED:
        rows += [
            [count, *_nobody(algorithm)] for count in ALL_COUNTS if (algorithm, count) not in have
        ]
    head = ("demonstrations", *TRAINED, *_RESULT, *COST)
    return Table(
        "demonstrations",
        "Fig. 5 in numbers: demonstrations, Anchor Space",
        basis(chosen),
        head,
        rows,
    )


def counted(runs: Iterable[Run]) -> list[Run]:
    """Runs in Anchor Space that differ in algorithm and number of demonstrations only."""
    found = []
    for run in runs:
        s = run.setting
        if (
            is_of_paper(s)
            and s.space == "anchor"
            and s.algorithm in COUNTED
            and not s.changes
            and not s.randomize
        ):
            found.append(run)
    return found


def generalization(runs: Sequence[Run]) -> Table:
    """Table III: trained in one space, tested in another, in its engine; also with what any method can be given."""
    chosen = [
        run for run in runs if is_usual(run.setting) and run.setting.changes in ((), *_GENERAL)
    ]
    chosen = [run for run in chosen if run.setting.algorithm != JACOBIAN]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        rows.append(
            [
                *trained(setting),
                SPACES[setting.space],
                *(_success(group, "nominal", space=space) for space in SPACES),
                _success(group, AROUND, space=AROUND),
                *cost(group),
            ]
        )
    have = {run.setting.space for run in chosen if run.setting.algorithm == "batd3"}
    for space in SPACES:
        if space not in have:
            rows.append(
                [
                    algorithm_title("batd3"),
                    "-",
                    engine_title("mujoco"),
                    SPACES[space],
                    *[None] * 4,
                    *cost(None),
                ]
            )
    head = (*TRAINED, "on", *(f"κ in {title}" for title in SPACES.values()), "κ all around", *COST)
    return Table("table3", "Table III: generalization between spaces", basis(chosen), head, rows)


def robustness(runs: Sequence[Run]) -> Table:
    """Table IV: success under disturbances, in the space and engine of training; level 0 is the nominal evaluation."""
    chosen = [run for run in runs if is_usual(run.setting) and "disturbances" in run.evaluations]
    groups = grouped(chosen, "space")
    policies = [
        run for run in chosen if run.setting.algorithm != JACOBIAN
    ]  # to it no packet is lost
    rows: list[list[Value]] = []
    for axis, letter in DISTURBANCES.items():
        for level in sorted({known for name, known, _ in TABLE_4 if name == axis}):
            for setting, group in groups.items():
                values: list[Value] = []
                for space in SPACES:
                    cell = disturbed(at_home(group, space), axis, level, space)
                    values += [cell.success, cell.length] if cell else [None, None]
                rows.append([letter, level, *trained(setting), *values, *cost(group)])
            rows.append([letter, level, *_anybody(policies, axis, level)])
            if not any(setting.algorithm == "batd3" for setting in groups):
                rows.append(
                    [
                        letter,
                        level,
                        algorithm_title("batd3"),
                        "-",
                        engine_title("mujoco"),
                        *[None] * 6,
                        *cost(None),
                    ]
                )
    columns = [name for title in SPACES.values() for name in (f"κ {title}", f"l_epi {title}")]
    note = basis(chosen) + (
        " Seeds are counted over the three spaces together. The rows `any run` count the targets that at least one of"
        " the policies above them reaches under that disturbance, their intervals are over targets: of any policy's"
        " loss that much is not its own."
    )
    return Table(
        "table4", "Table IV: robustness", note, ("what", "level", *TRAINED, *columns, *COST), rows
    )


def _anybody(runs: Sequence[Run], axis: str, level: float) -> list[Value]:
    """The rest of a row: the share of targets that at least one run reaches under a disturbance, in each space."""
    values: list[Value] = []
    count = 0
    for space in SPACES:
        cell = disturbed(at_home(runs, space), axis, level, space)
        values += [rate([_united(cell.episodes)]) if cell else None, "-"]
        count += len(cell.runs) if cell else 0
    return [ANYBODY, "-", "-", *values, count, *["-"] * (len(COST) - 1)]


def _united(found: Sequence[Episodes]) -> NDArray[np.bool_]:
    """Of each target that occurs, whether any of them succeeds there."""
    targets = np.concatenate([one.episode for one in found])
    success = np.concatenate([one.success for one in found])
    return np.isin(np.unique(targets), targets[success])


def disturbed(runs: Sequence[Run], axis: str, level: float, space: str) -> Cell | None:
    """The cell of Table IV for some seeds; without a row of its own, level 0 is the nominal evaluation."""
    cell = measure(runs, "disturbances", space=space, axis=axis, level=level)
    return measure(runs, "nominal", space=space) if cell is None and level == 0 else cell


def transfer(runs: Sequence[Run]) -> Table:
    """Every method trained in each engine and tested in each, in the space of training, on the same targets."""
    chosen = [
        run
        for run in runs
        if is_of_paper(run.setting) and run.setting.num_demonstrations in (0, DEMONSTRATIONS)
    ]
    chosen = [run for run in chosen if not run.setting.changes]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for space in SPACES:
        for setting, group in grouped(chosen, "space").items():
            seeds = at_home(group, space)
            if seeds:
                rows.append(
                    [
                        SPACES[space],
                        *trained(setting),
                        *_in_engines(seeds, engines, space),
                        *cost(seeds),
                    ]
                )
    head = ("space", *TRAINED, *_engine_heads(engines), *COST)
    note = (
        basis(chosen)
        + " Disagreements count the episodes of all seeds that succeed in one engine only, of how many."
    )
    return Table("transfer", "Transfer between engines", note, head, rows)


def tasks(runs: Sequence[Run]) -> Table:
    """Tasks and spaces past the paper, in every engine."""
    chosen = [run for run in runs if not is_of_paper(run.setting)]
    engines = engines_of(chosen)
    rows: list[list[Value]] = []
    for setting, group in sorted(
        grouped(chosen).items(), key=lambda item: (item[0].task, item[0].space)
    ):
        rows.append(
            [
                setting.task,
                setting.space,
                *trained(setting),
                *_in_engines(group, engines, setting.space),
                *cost(group),
            ]
        )
    head = ("task", "space", *TRAINED, *_engine_heads(engines), *COST)
    return Table("tasks", "Tasks past the paper", basis(chosen), head, rows)


def halvings(runs: Sequence[Run]) -> Table:
    """Where success halves as one number of the plant leaves what was trained on."""
    chosen = [run for run in runs if "plants" in run.evaluations]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        for engine, space, (axis, description) in product(
            engines_of(group, "plants"), SPACES, AXES.items()
        ):
            found = sweeps(group, axis, engine, space)
            if found:
                low = min(float(one.levels[0]) for one in found.values())
                high = max(float(one.levels[-1]) for one in found.values())
                rows.append(
                    [
                        *trained(setting),
                        SPACES[space],
                        engine_title(engine),
                        description.title,
                        f"{low:g} to {high:g}",
                        *(_halving(list(found.values()), description, side) for side in SIDES),
                        *cost([run for run in group if run.name in found]),
                    ]
                )
    head = (*TRAINED, "space", "tested in", "plant", "swept", "halves below", "halves above", *COST)
    note = basis(chosen) + (
        " Means over seeds, interpolated between levels, by ratio where they are factors;"
        " intervals redraw seeds and episodes. `none`: success does not halve within the sweep;"
        " `-`: not swept on that side, or nothing succeeds on the plant trained on."
    )
    return Table("plants", "Levels of the plant at which success halves", note, head, rows)


def all_tables(runs: Sequence[Run]) -> Iterator[Table]:
    """Every table of the study."""
    for table in (
        comparison,
        ablation,
        own_ablation,
        presets,
        raised,
        demonstrations,
        generalization,
        robustness,
        transfer,
        halvings,
        tasks,
    ):
        yield table(runs)


def engines_of(runs: Iterable[Run], evaluation: str = "nominal") -> list[str]:
    """The engines that some runs were evaluated in, ours first."""
    names = {
        str(x)
        for run in runs
        if evaluation in run.evaluations
        for x in run.evaluations[evaluation].backend
    }
    installed = backend_names()
    return sorted(names, key=lambda name: (name not in installed, name))


def basis(runs: Sequence[Run]) -> str:
    """What some numbers rest on, in a sentence."""
    if not runs:
        return "No run of this is finished."
    return (
        f"{amount([len(runs)], 'run')}, {amount(map(len, grouped(runs).values()), 'seed')} a setting, "
        f"{amount((run.updates for run in runs), 'update')} a run, "
        f"{np.sum([run.minutes for run in runs]):.0f} minutes of training in all."
    )


def _home_rows(runs: Sequence[Run], space: str, wanted: Sequence[str]) -> Iterator[list[Value]]:
    """Rows of one space, with one for each algorithm wanted that has no run in it."""
    have = set()
    for setting, group in grouped(runs, "space").items():
        seeds = at_home(group, space)
        if seeds:
            have.add(setting.algorithm)
            yield [SPACES[space], *trained(setting), *_result(seeds, space=space), *cost(seeds)]
    for algorithm in wanted:
        if algorithm not in have:
            yield [SPACES[space], *_nobody(algorithm)]


def _result(seeds: Sequence[Run], space: str) -> list[Value]:
    cell = measure(seeds, "nominal", space=space)
    return [cell.success, cell.iqm or "-", cell.length] if cell else [None, None, None]


def _success(seeds: Sequence[Run], evaluation: str, space: str, engine: str | None = None) -> Value:
    cell = measure(seeds, evaluation, engine, space=space)
    return cell.success if cell else None


def _nobody(algorithm: str) -> list[Value]:
    return [algorithm_title(algorithm), "-", engine_title("mujoco"), None, None, None, *cost(None)]


def _engine_heads(engines: Sequence[str]) -> list[str]:
    titles = [engine_title(name) for name in engines]
    return [f"κ in {title}" for title in titles] + [
        f"only {a} / only {b}" for a, b in combinations(titles, 2)
    ]


def _in_engines(seeds: Sequence[Run], engines: Sequence[str], space: str) -> list[Value]:
    values = [_success(seeds, "nominal", space, engine) for engine in engines]
    return values + [_disagreements(seeds, pair, space) for pair in combinations(engines, 2)]


def _disagreements(seeds: Sequence[Run], engines: tuple[str, str], space: str) -> Value:
    counts, total = np.zeros(2, dtype=int), 0
    for run in seeds:
        if "nominal" in run.evaluations:
            first, second = (
                run.evaluations["nominal"].where(backend=name, space=space) for name in engines
            )
            if len(first) and np.array_equal(first.episode, second.episode):
                counts += disagreement(first.success, second.success)
                total += len(first)
    return f"{counts[0]} / {counts[1]} of {total}" if total else None


def _halving(found: Sequence[Sweep], axis: Axis, side: Literal["above", "below"]) -> Value:
    """As `cdcsr sweep` finds it: a level midway between two factors is their geometric mean."""
    ratio = axis.unit == "factor" and all(one.levels.min() > 0 for one in found)
    scaled = [replace(one, levels=np.log(one.levels)) if ratio else one for one in found]
    crossing = halving(scaled, float(np.log(axis.nominal)) if ratio else axis.nominal, side)
    if crossing is None:
        return "-"
    level, low, high = (
        "none" if not np.isfinite(value) else f"{np.exp(value) if ratio else value:.3g}"
        for value in (crossing.level, crossing.low, crossing.high)
    )
    return f"{level} [{low}, {high}]"
