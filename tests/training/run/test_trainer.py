"""The training run: what it leaves, how it resumes, and what it refuses."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from safetensors.torch import load_file

from cdcsr.envs.gym_env import Info, TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.workspace_map import load_workspace
from tests.support.tiny import FRAME_SKIP, Options, tiny_changes
from training.algorithms.bc import BehaviourCloning
from training.commands.demonstrate import demonstrate
from training.experience.collector import Collector, FinishedEpisode
from training.measure.evaluation import Result
from training.networks.actor import Actor
from training.networks.bfloat16 import has_fast_bfloat16
from training.policy import Policy, load_policy
from training.run.setup import Setup
from training.run.train_options import Train, train_options
from training.run.trainer import Run, train
from training.study.declare.budgets import BUDGETS
from training.study.declare.grid import EXPERIMENTS, collect

PAPER = load_robot("paper")


def _config(
    out: Path,
    demonstrations: Path | None,
    *,
    algorithm: str = "batd3",
    numbers: dict[str, object] | None = None,
    **options: Any,
) -> Train:
    usual = {
        "space": "spatter",
        "frame_skip": FRAME_SKIP,
        "evaluate_every": 20,
        "evaluate_episodes": 4,
        "updates": 60,
    }
    return Train(
        out=out,
        demonstrations=demonstrations,
        algorithm=algorithm,
        changes=tiny_changes(algorithm, **(numbers or {})),
        **{**usual, **options},
    )


def test_a_run_leaves_policy_metrics_and_summary(tmp_path: Path, demonstrations: Path) -> None:
    out = tmp_path / "run"
    train(_config(out, demonstrations, json=tmp_path / "summary.json"))
    with (out / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["update"] for row in rows] == ["20", "40", "60"]
    assert [row["environment_steps"] for row in rows] == ["80", "160", "240"]
    assert list((out / "tensorboard").glob("events*"))
    policy = load_policy(out)
    assert policy.card["updates"] == 60
    assert policy.card["environment_steps"] == 240
    assert len(policy.centers) == 3
    assert not (out / "state.safetensors").exists()
    assert load_policy(out / "clone").card["algorithm"] == "bc"
    assert json.loads((tmp_path / "summary.json").read_text())["validation"]["episodes"] == 4


_EVERYTHING = {
    "hindsight": 2,
    "kept_share": 0.25,
    "clone_start": True,
    "clone_anchor": 1.0,
    "self_imitation": 1.0,
    "noise_ladder": True,
    "practice": 0.2,
    "updates_per_step": 2,
}


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        ("td3", {}),
        ("batd3", {}),
        ("rbl", {}),
        # Long enough for plants that are drawn after the stop to be learned from.
        ("td3", {"randomize": 1.0, "updates": 120}),
        pytest.param(
            "batd3",
            {"numbers": {"hidden": (64, 64), "batch_size": 64, "bfloat16": True}},
            marks=pytest.mark.skipif(
                not has_fast_bfloat16(), reason="this processor has no use for bfloat16"
            ),
        ),
        ("clasp", {"numbers": _EVERYTHING, "updates": 120}),
        ("her", {"task": "capture-drift", "numbers": {"hindsight": 1}}),
    ],
)
def test_a_stopped_run_goes_on_to_the_same_bits(
    tmp_path: Path,
    demonstrations: Path,
    monkeypatch: pytest.MonkeyPatch,
    algorithm: str,
    options: Options,
) -> None:
    given = demonstrations
    if "task" in options:  # those are of reaching
        given, options = None, {**options, "num_demonstrations": 1}
    whole = train(_config(tmp_path / "whole", given, algorithm=algorithm, **options))
    halves = _config(
        tmp_path / "halves", given, algorithm=algorithm, **options, evaluate_every=1000
    )
    with monkeypatch.context() as patch:  # half-way, in the middle of episodes
        calls = itertools.count(1)
        patch.setattr(Run, "_out_of_time", lambda run: next(calls) == run.config.updates // 2)
        assert train(halves).card.get("updates") is None
    assert (tmp_path / "halves" / "state.safetensors").exists()
    resumed = train(halves)
    assert resumed.card["updates"] == whole.card["updates"] == halves.updates
    a, b = (load_file(tmp_path / name / "policy.safetensors") for name in ("whole", "halves"))
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name].numpy(), b[name].numpy())


def test_a_run_with_other_options_is_refused_and_kept(tmp_path: Path, demonstrations: Path) -> None:
    out = tmp_path / "run"
    config = _config(out, demonstrations, algorithm="bc")
    train(config)
    before = (out / "policy.safetensors").read_bytes()
    with pytest.raises(CdcsrError, match=r"other options \(learner\.bc_updates, seed\)"):
        train(dataclasses.replace(config, seed=1, changes=tiny_changes("bc", bc_updates=50)))
    assert (out / "policy.safetensors").read_bytes() == before


def test_a_run_with_another_dataset_under_the_same_name_is_refused(
    tmp_path: Path, demonstrations: Path
) -> None:
    data, out = tmp_path / "demonstrations", tmp_path / "run"
    shutil.copytree(demonstrations, data)
    train(_config(out, data, algorithm="bc"))
    shutil.rmtree(data)
    demonstrate(out=data, episodes=3, frame_skip=FRAME_SKIP, seed=1)
    with pytest.raises(CdcsrError, match=r"other options \(dataset\)"):
        train(_config(out, data, algorithm="bc"))


def test_a_run_with_another_map_under_the_same_name_is_refused(
    tmp_path: Path, demonstrations: Path
) -> None:
    path, out = tmp_path / "mine.npz", tmp_path / "run"
    whole = load_workspace(PAPER)
    whole.save(path)
    train(_config(out, demonstrations, algorithm="bc", space=str(path)))
    train(_config(out, demonstrations, algorithm="bc", space=str(path)))
    dataclasses.replace(whole, cells=whole.cells[:-1]).save(path)
    with pytest.raises(CdcsrError, match=r"other options \(map\)"):
        train(_config(out, demonstrations, algorithm="bc", space=str(path)))


@pytest.mark.parametrize(
    "other",
    [
        {"task": "capture"},
        {"randomize": 1.0},
        {"num_demonstrations": 5},
        {"space": "anchor"},
        {"frame_skip": 2},
    ],
)
def test_a_run_is_another_with_any_option_that_matters(other: Options) -> None:
    config = _config(Path("run"), None)
    assert dataclasses.replace(config, **other).identity(PAPER) != config.identity(PAPER)
    assert dataclasses.replace(config, out=Path("x"), stop_after=1.0, force=True).identity(
        PAPER
    ) == config.identity(PAPER)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path, demonstrations: Path) -> None:
    (tmp_path / "thesis.tex").write_text("do not lose me")
    with pytest.raises(CdcsrError, match="not a training run"):
        train(_config(tmp_path, demonstrations))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_damaged_state_is_one_clear_line(tmp_path: Path, demonstrations: Path) -> None:
    config = _config(tmp_path / "run", demonstrations)
    train(dataclasses.replace(config, stop_after=0.0))
    path = tmp_path / "run" / "state.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CdcsrError, match=r"state\.safetensors is damaged .* --force"):
        train(config)


@pytest.mark.parametrize(
    "misspelt", [{"backend": "mujco"}, {"space": "anker"}, {"robot": "papre"}, {"task": "captur"}]
)
def test_a_misspelt_name_leaves_no_folder(
    tmp_path: Path, demonstrations: Path, misspelt: Options
) -> None:
    with pytest.raises(CdcsrError, match="Unknown"):
        train(_config(tmp_path / "run", demonstrations, **misspelt))
    assert not (tmp_path / "run").exists()


def test_demonstrations_of_another_robot_are_refused(tmp_path: Path, demonstrations: Path) -> None:
    with pytest.raises(CdcsrError, match="are of robot 'paper'"):
        train(_config(tmp_path / "run", demonstrations, robot="three-cable"))
    assert not (tmp_path / "run").exists()


def test_practice_is_past_the_space_and_measured_within_it(
    tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, list[float]] = {"practised": [], "measured": [], "shown": []}
    anchor = load_robot("paper").workspace

    def outside(targets: NDArray[np.float64]) -> list[float]:
        far = np.abs(targets - anchor.center) - np.array(anchor.size) / 2
        return far.max(axis=1).clip(0).tolist()

    step, measure, reset = Collector.step, Setup.validate, TaskVectorEnv.reset

    def watched_reset(self: TaskVectorEnv, **options: Any) -> tuple[NDArray[np.float64], Info]:
        begun = reset(self, **options)
        if (
            self.metadata["autoreset_mode"] is AutoresetMode.DISABLED
        ):  # the clone's episodes and measurements
            seen["shown"] += outside(self.targets)
        return begun

    def watched_step(self: Collector, actor: Actor) -> Iterator[FinishedEpisode]:
        seen["practised"] += outside(self.env.targets)
        return step(self, actor)

    def watched_measure(self: Setup, policy: Policy) -> Result:
        result = measure(self, policy)
        seen["measured"] += outside(result.targets)
        return result

    monkeypatch.setattr(Collector, "step", watched_step)
    monkeypatch.setattr(Setup, "validate", watched_measure)
    monkeypatch.setattr(TaskVectorEnv, "reset", watched_reset)
    numbers: dict[str, object] = {"practice": 0.5}
    train(_config(tmp_path / "run", demonstrations, space="anchor", numbers=numbers))
    assert 0.1 < max(seen["practised"]) < 0.5
    assert 0 in seen["practised"]
    assert max(seen["measured"]) < 1e-12
    assert len(seen["shown"]) > len(seen["measured"])
    assert max(seen["shown"]) < 1e-12


def test_the_clone_alone_has_no_options_of_practice(tmp_path: Path) -> None:
    for name, value in {"hindsight": 2, "noise_ladder": True, "bfloat16": True}.items():
        run = Train(out=tmp_path, algorithm="bc", changes=((name, value),))
        with pytest.raises(CdcsrError, match=f"Unknown option of this algorithm '{name}'"):
            train(run)


def test_every_run_of_the_study_can_be_trained() -> None:
    runs = collect(list(EXPERIMENTS), BUDGETS["paper"]).values()
    assert len(runs) > 500
    for spec in {dataclasses.replace(spec, seed=0) for spec, _ in runs}:
        if spec.trains and ("bfloat16", True) not in spec.changes:
            Setup(train_options(spec, Path("nowhere")))


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"capacity": 31}, "capacity must be at least 32, a batch and an episode"),
        ({"capacity": 25, "batch_size": 8}, "capacity must be at least 26"),
        ({"kept_share": 0.5}, "Unknown option of this algorithm 'kept_share'"),
        ({"self_imitation": 1.0}, "Unknown option of this algorithm 'self_imitation'"),
        ({"noise_ladder": True, "num_envs": 1}, "noise_ladder needs num_envs of at least 2"),
    ],
)
def test_numbers_that_cannot_serve_are_refused(
    tmp_path: Path, demonstrations: Path, numbers: dict[str, object], message: str
) -> None:
    with pytest.raises(CdcsrError, match=message):
        train(_config(tmp_path / "run", demonstrations, algorithm="td3", numbers=numbers))
    assert not (tmp_path / "run").exists()


def test_a_finished_run_writes_its_summary_again_and_force_leaves_no_policy(
    tmp_path: Path, demonstrations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = _config(tmp_path / "run", demonstrations, algorithm="bc")
    train(config)
    train(dataclasses.replace(config, json=tmp_path / "again.json"))
    assert json.loads((tmp_path / "again.json").read_text()) == json.loads(
        (tmp_path / "run/summary.json").read_text()
    )

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BehaviourCloning, "fit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(dataclasses.replace(config, force=True, seed=1))
    with pytest.raises(CdcsrError, match="holds no policy"):
        load_policy(tmp_path / "run")


def test_a_task_that_does_not_end_is_discounted(tmp_path: Path, demonstrations: Path) -> None:
    numbers: dict[str, object] = {"discount": 1.0}
    with pytest.raises(CdcsrError, match="discount must be below 1 for 'follow-line'"):
        train(_config(tmp_path / "run", demonstrations, task="follow-line", numbers=numbers))
    assert not (tmp_path / "run").exists()


def test_a_finished_run_records_no_demonstrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = _config(tmp_path / "run", None, algorithm="bc", num_demonstrations=1)
    train(config)

    def record(*_: object, **__: object) -> None:
        raise AssertionError("a demonstration was recorded")

    monkeypatch.setattr("controllers.demonstrations.record", record)
    assert train(config).card["updates"] == 0
    with pytest.raises(AssertionError, match="recorded"):
        train(_config(tmp_path / "other", None, algorithm="bc"))
