"""Learning curves of variants: a panel for each change, beside the learner as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

import numpy as np

from cdcsr.plots import drawn, short_count
from cdcsr.simulation.engines import engine_title
from training.algorithms.registry import algorithm_color, algorithm_title
from training.config.run_description import RunDescription
from training.study.report.learning_curves import (
    Figures,
    aligned,
    by_kind,
    caption,
    draw_curve,
    legend,
    tidy,
)
from training.study.report.records import SPACES, Run, grouped, plain_text
from training.study.report.tables_beyond import variants

COLUMNS = 5
_CHANGED = "with the change"


def variant_figures(runs: Sequence[Run], out: Path) -> Figures:
    """Draw the learning curves of every variant, a figure for each preset, engine and space."""
    for (preset, engine, updates), some in sorted(by_kind(variants(runs)).items()):
        for space, title in SPACES.items():
            groups = grouped(run for run in some if run.setting.space == space)
            pairs = [(s, replace(s, changes=())) for s in groups if s.changes]
            if not pairs:
                continue
            file = f"variants-{preset}-{space}-{engine}{f'-u{updates}' if updates else ''}.png"
            _draw(pairs, groups, out / file)
            own = [run for group in groups.values() for run in group]
            length = f", {updates} updates" if updates else ""
            yield (
                file,
                (
                    f"Variants in {title} Space, each beside its algorithm without the change,"
                    f" trained in {engine_title(engine)}{length}. {caption(own)}"
                ),
            )


def _draw(
    pairs: Sequence[tuple[RunDescription, RunDescription]],
    groups: dict[RunDescription, list[Run]],
    path: Path,
) -> None:
    columns = min(COLUMNS, len(pairs))
    rows = -(-len(pairs) // columns)
    with drawn(path, (2.3 * columns + 0.5, 2.3 * rows + 0.6), "constrained") as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        lowest = 1.0
        for axes, (changed, plain) in zip(grid.flat, pairs, strict=False):
            for setting, label, color in (
                (plain, algorithm_title(plain.algorithm), algorithm_color(plain.algorithm)),
                (changed, _CHANGED, algorithm_color("td3wd")),
            ):
                group = groups.get(setting, [])
                draw_curve(axes, setting, group, label, color, "-")
                updates, curves = aligned(group)
                if len(updates):
                    lowest = min(lowest, float(curves.mean(axis=0)[-1]))
            switches = [f"{name} = {plain_text(value)}" for name, value in changed.changes]
            title = fill(f"{algorithm_title(changed.algorithm)}: {', '.join(switches)}", 34)
            axes.set_title(title, fontsize=7.5)
            axes.set_xlim(left=0)
            axes.xaxis.set_major_formatter(short_count)
            tidy(axes)
        for axes in grid.flat[len(pairs) :]:
            axes.set_visible(False)
        for axes in grid.flat[max(0, len(pairs) - columns) : len(pairs)]:  # nothing is below them
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("updates", fontsize=9)
        grid[0, 0].set_ylim(max(-0.02, float(np.floor(10 * lowest) / 10) - 0.4), 1.02)
        figure.supylabel("success on validation targets", fontsize=9)
        legend(figure, 4)
