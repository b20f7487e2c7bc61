"""Near a demonstration and far from all: the environment's targets, cells by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import imageio.v2 as imageio
import numpy as np
import pytest
from PIL import ImageColor

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from controllers.demonstrations import record
from controllers.jacobian import JacobianController
from tests.support.small_study import find, nominal, write_run
from training.algorithms.registry import ALGORITHMS
from training.config.seeds import TEST_SEED
from training.study.report import nearness as module
from training.study.report.nearness import (
    distances,
    far_captures,
    nearness,
    nearness_figures,
)
from training.study.report.records import load_study

ROBOT = load_robot("paper")


@pytest.mark.parametrize(
    ("space", "task"), [("anchor", "reach"), ("anchor", "capture-drift"), ("spatter", "reach")]
)
def test_distances_are_those_of_the_targets_that_are_measured_on(space: str, task: str) -> None:
    """The targets are those of a recording, and those that an environment draws."""
    with_ten = TaskVectorEnv(10, ROBOT, "mujoco", "anchor", autoreset_mode="Disabled")
    episodes, *_ = record(JacobianController(ROBOT), with_ten, 10, seed=0)
    shown = np.array([episode.target for episode in episodes])
    env = TaskVectorEnv(
        40, ROBOT, "mujoco", space, task=task, centers=shown, autoreset_mode="Disabled"
    )
    env.reset(seed=TEST_SEED)
    expected = [min(np.linalg.norm(target - one) for one in shown) for target in env.targets]
    np.testing.assert_allclose(distances(ROBOT, space, 40), expected)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four targets: two within 30 mm of a demonstration, one to 90 mm, one farther."""
    monkeypatch.setattr(module, "distances", lambda *_: np.array([0.089, 0.0, 0.029, 0.09]))
    for seed, outcomes in enumerate(("0110", "0111")):
        write_run(tmp_path, f"a{seed}", {"nominal": [nominal(outcomes)]}, seed=seed)
    write_run(tmp_path, "task", {"nominal": [nominal("1000")]}, task="capture")
    write_run(
        tmp_path,
        "clone",
        {"nominal": [nominal("1111", "spatter")]},
        algorithm="bc",
        space="spatter",
    )
    for name, spec in {
        "few": {"demonstrations": 3},
        "switched": {"switches": {"critics": 5}},
        "random": {"randomize": 1.0},
        "paper": {"preset": "paper"},
        "floating": {"space": "floating"},
        "around": {"space": "workspace"},
    }.items():
        write_run(
            tmp_path, name, {"nominal": [nominal("1111", str(spec.get("space", "anchor")))]}, **spec
        )
    for folder in tmp_path.iterdir():
        path = folder / "run.json"
        path.write_text(
            path.read_text("utf-8").replace(
                '"fingerprint": "f"', f'"fingerprint": "{ROBOT.fingerprint}"'
            )
        )
    write_run(tmp_path, "other-robot", {"nominal": [nominal("0000")]}, algorithm="td3")
    return tmp_path


def test_each_distance_has_its_targets_and_its_success(study: Path) -> None:
    row = find(nearness(load_study(study)), algorithm="BATD3", task="reach")
    assert [
        row[f"targets {name}"] for name in ("to 30 mm", "to 60 mm", "to 90 mm", "from 90 mm")
    ] == [2, 0, 1, 1]
    assert row["κ to 30 mm"].value == 1
    assert row["κ to 60 mm"] == "-"
    assert row["κ to 90 mm"].value == 0
    assert row["κ from 90 mm"].value == 0.5
    assert row["seeds"] == 2


def test_rows_are_plain_runs_of_the_known_robot_that_saw_the_ten(study: Path) -> None:
    table = nearness(load_study(study))
    assert [tuple(row[:3]) for row in table.rows] == [
        ("reach", "Anchor", "BATD3"),
        ("reach", "Spatter", "BC"),
        ("capture", "Anchor", "BATD3"),
    ]


def test_a_figure_shows_the_methods_of_one_engine_and_length(study: Path, tmp_path: Path) -> None:
    """By their colours: methods are drawn, ablations and runs of another length are not."""
    known = {"nominal": [nominal("1111")]}
    for name, spec in {
        "ablation": {"algorithm": "batd3-no-bc"},
        "long": {"algorithm": "td3wd", "updates": 4000},
    }.items():
        path = write_run(study, name, known, **spec) / "run.json"
        path.write_text(
            path.read_text("utf-8").replace(
                '"fingerprint": "f"', f'"fingerprint": "{ROBOT.fingerprint}"'
            )
        )
    ((file, said),) = nearness_figures(load_study(study), tmp_path)
    assert file == "nearness-mujoco.png"
    assert "1 to 2 seeds" in said
    picture = imageio.imread(tmp_path / file)[..., :3]
    seen = {
        name
        for name, entry in ALGORITHMS.items()
        if not entry.ablation
        if (picture == ImageColor.getrgb(entry.color)).all(axis=2).sum() > 20
    }
    assert seen - {"drldr"} == {"batd3", "bc"}  # its colour is that of text


def test_far_captures_keep_later_seeds_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two targets of four are far; a budget of three seeds ends with seed 2."""
    monkeypatch.setattr(module, "distances", lambda *_: np.array([0.089, 0.09, 0.029, 0.2]))
    monkeypatch.setattr(module, "load_robot", lambda _: SimpleNamespace(fingerprint="f"))
    for seed, outcomes in enumerate(("1010", "1110", "1111", "0001", "0101")):
        write_run(
            tmp_path,
            f"r{seed}",
            {"nominal": [nominal(outcomes)]},
            seed=seed,
            algorithm="clasp",
            task="capture",
            budget="standard",
        )
    assert far_captures(load_study(tmp_path)).markdown().splitlines()[2:] == [
        "| MuJoCo     | 0 to 2 | 0.50 [0.00, 1.00] | 0.00, 0.50, 1.00 |",
        "| MuJoCo     | 3 to 4 | 0.75 [0.50, 1.00] | 0.50, 1.00       |",
    ]
