"""The study of transfer: recipes trained in one engine and tested in all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from cdcsr.plots import COLORS, SOFT, drawn
from cdcsr.simulation.engines import engine_title
from training.measure.statistics import Estimate, over_few_seeds
from training.study.report.cells import TRAINED, Table, Value, trained, who
from training.study.report.learning_curves import Figures, legend, tidy
from training.study.report.records import Run, grouped
from training.study.report.table_parts import basis, engines_of

EVALUATION = "engines"
FIGURE = "transfer.png"
_MARKERS = "oD^v"
"""There are more recipes than colours; each marker begins with the first colour."""


def transfer(runs: Sequence[Run]) -> Table:
    """Return the success of each recipe in each engine, and its loss against that of training."""
    chosen = [run for run in runs if EVALUATION in run.evaluations]
    engines = [name for name in engines_of(chosen, EVALUATION) if ":" not in name]
    rows: list[list[Value]] = []
    for setting, group in grouped(chosen).items():
        home_engine = setting.backend.partition("+")[0]  # of several engines the first
        home = _success(group, home_engine)
        found = [_success(group, engine) for engine in engines]
        rates = [_estimate(one) for one in found]
        losses = [
            "-" if engine == home_engine else _difference(one, home)
            for engine, one in zip(engines, found, strict=True)
        ]
        rows.append([*trained(setting), setting.task, setting.space, *rates, *losses, len(group)])
    titles = [engine_title(engine) for engine in engines]
    head = (
        *TRAINED,
        "task",
        "space",
        *(f"κ in {title}" for title in titles),
        *(f"difference in {title}" for title in titles),
        "seeds",
    )
    note = basis(chosen) + (
        " Each seed has demonstrations of its own. Intervals hold for five seeds; differences from"
        " the engine of training, or the first of two, are paired by target."
    )
    return Table("transfer", "Transfer between engines", note, head, rows)


def transfer_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw the success of each recipe in each engine."""
    chosen = [run for run in runs if EVALUATION in run.evaluations]
    if not chosen:
        return
    engines = [name for name in engines_of(chosen, EVALUATION) if ":" not in name]
    problems = list(dict.fromkeys((run.setting.task, run.setting.space) for run in chosen))
    with drawn(out / FIGURE, (8.6, 3.4 * len(problems) + 1), "constrained") as figure:
        panels = figure.subplots(len(problems), sharex=True, squeeze=False)[:, 0]
        recipes = dict.fromkeys(map(_recipe, chosen))
        looks = dict(zip(recipes, product(_MARKERS, COLORS), strict=False))
        for axes, problem in zip(panels, problems, strict=True):
            runs_here = [r for r in chosen if (r.setting.task, r.setting.space) == problem]
            _panel(axes, runs_here, engines, looks)
            axes.set_title(f"{problem[0]}, {problem[1].capitalize()}")
        panels[-1].set_xlabel("tested in")
        legend(figure, 2)
    yield FIGURE, "Success in each engine; small dots are seeds, bars 95 % intervals over seeds."


def _recipe(run: Run) -> str:
    return f"{who(run.setting)}, trained in {engine_title(run.setting.backend)}"


def _panel(
    axes: Axes, runs: Sequence[Run], engines: Sequence[str], looks: Mapping[str, tuple[str, str]]
) -> None:
    groups = grouped(runs)
    for i, group in enumerate(groups.values()):
        label = _recipe(group[0])
        shift = min(0.14, 0.8 / len(groups)) * (i - (len(groups) - 1) / 2)
        for x, engine in enumerate(engines):
            scores = _success(group, engine)
            if scores is not None:
                _draw(axes, x + shift, scores, *looks[label], label if x == 0 else "")
    axes.set_xticks(range(len(engines)), [engine_title(name) for name in engines])
    axes.set_ylabel("success on 100 targets")
    for x in range(1, len(engines)):
        axes.axvline(x - 0.5, color=SOFT, lw=0.6)
    tidy(axes)


def _draw(
    axes: Axes, x: float, scores: NDArray[np.float64], marker: str, color: str, label: str
) -> None:
    rates = scores.mean(axis=1)
    axes.plot(np.full(len(rates), x), rates, ".", color=color, alpha=0.45, ms=5)
    found = _estimate(scores)
    if found is not None:
        ends = [[found.value - found.low], [found.high - found.value]]
        axes.errorbar(x, found.value, ends, fmt=marker, color=color, ms=6, capsize=3, label=label)


def _success(group: Sequence[Run], engine: str) -> NDArray[np.float64] | None:
    """Return success, shape (seeds, targets), of the runs of a group in an engine."""
    found = [run.evaluations[EVALUATION].where(backend=engine).success for run in group]
    return np.array(found, dtype=float) if all(len(one) for one in found) else None


def _estimate(scores: NDArray[np.float64] | None) -> Estimate | None:
    return None if scores is None or len(scores) < 2 else over_few_seeds(scores)


def _difference(
    scores: NDArray[np.float64] | None, home: NDArray[np.float64] | None
) -> Estimate | None:
    if scores is None or home is None or len(scores) < 2:
        return None
    return over_few_seeds(scores - home, paired=True)
