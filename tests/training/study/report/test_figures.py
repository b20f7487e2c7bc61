"""Learning curves and the figures of variants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.small_study import nominal, write_run
from training.study.report.learning_curves import aligned, curve_figures
from training.study.report.records import load_study
from training.study.report.variant_plots import variant_figures


def test_curves_are_compared_where_all_seeds_have_been(study: Path) -> None:
    updates, curves = aligned([run for run in load_study(study) if run.setting.space == "anchor"])
    assert updates.tolist() == [500, 1000]
    assert curves.tolist() == [[0.0, 0.5], [0.1, 0.5], [0.2, 0.5]]


def test_curves_of_another_length_have_a_figure_of_their_own(study: Path, tmp_path: Path) -> None:
    before = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert "fig3-tuned-mujoco.png" in before
    curve = [(1000, 0.5), (4000, 0.9)]
    for algorithm in ("td3", "clasp"):
        results = {"nominal": [nominal("1111")]}
        write_run(study, algorithm, results, curve, algorithm=algorithm, updates=4000)
    after = [name for name, _ in curve_figures(load_study(study), tmp_path)]
    assert after == [*before[:1], "fig3-tuned-mujoco-u4000.png", *before[1:]]


def test_each_variant_has_a_panel_beside_what_it_is_a_variant_of(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, float]] = []

    def draw(*arguments: Any) -> None:
        _, _, group, label, *_ = arguments
        drawn.append((label, aligned(group)[1][:, -1].mean()))

    monkeypatch.setattr("training.study.report.variant_plots.draw_curve", draw)
    for i, switches in enumerate(({"critics": 3}, {"discount": 0.9})):
        curve = [(500, 0.25), (1000, 0.75 + i / 8)]
        write_run(study, f"v{i}", {"nominal": [nominal("11")]}, curve, switches=switches)
    (figure,) = variant_figures(load_study(study), tmp_path)
    assert figure[0] == "variants-tuned-anchor-mujoco.png"
    assert drawn == [
        ("BATD3", 0.5),
        ("with the change", 0.75),
        ("BATD3", 0.5),
        ("with the change", 0.875),
    ]
