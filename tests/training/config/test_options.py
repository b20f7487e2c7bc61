"""The options of a training run: what they are by default, what they may be."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from cdcsr.cli import run
from cdcsr.errors import CdcsrError
from training.config.run_config import PRESETS, Learner, Train, learner_for

_SMALL = dataclasses.replace(
    PRESETS["tuned"],
    hidden=(16, 16),
    batch_size=32,
    num_envs=4,
    updates=60,
    bc_updates=100,
    bc_rollouts=4,
)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"clone_anchor": -3.0}, "clone_anchor must not be negative"),
        ({"target_critics": 3}, "target_critics must be between 1 and critics"),
        ({"batch_size": 0}, "batch_size must be at least 1"),
        ({"discount": 1.5}, "discount must lie in"),
        ({"learning_rate": -1.0}, "learning_rate must be positive"),
        ({"practice": -0.1}, "practice must be a distance"),
        ({"practice": float("nan")}, "practice must be a distance"),
        ({"exploration_noise": float("nan")}, "exploration_noise must be finite"),
        ({"learning_rate": float("inf")}, "learning_rate must be finite"),
        ({"noise_clip": -1.0}, "noise_clip must not be negative"),
        ({"hindsight": -2}, "hindsight must not be negative"),
        ({"soft_update": -3.0}, r"soft_update must lie in \(0, 1\]"),
        ({"final_learning_rate": -3.0}, "final_learning_rate must lie in"),
        ({"bc_rollouts": -3}, "bc_rollouts must be at least 1"),
        ({"hidden": ()}, "hidden must be the width of at least one layer"),
        ({"hidden": (16, 0)}, "hidden must be the width of at least one layer"),
    ],
)
def test_impossible_numbers_are_refused(numbers: dict[str, float], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        Train(out=Path("x"), learner=dataclasses.replace(_SMALL, **numbers))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 2**64}, "seed must be below"),
        ({"evaluate_every": -7}, "evaluate_every must not be negative"),
        ({"stop_after": float("nan")}, "stop_after must be a number of minutes"),
    ],
)
def test_impossible_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        Train(out=Path("x"), learner=_SMALL, **options)


def test_a_clone_does_not_practise() -> None:
    with pytest.raises(CdcsrError, match="practice must be 0 for bc"):
        Train(out=Path("x"), algorithm="bc", learner=dataclasses.replace(_SMALL, practice=0.1))
    with pytest.raises(CdcsrError, match="randomize must be 0 for bc"):
        Train(out=Path("x"), algorithm="bc", randomize=1.0)


@pytest.mark.parametrize("algorithm", ["clasp", "batd3"])
@pytest.mark.parametrize("flag", ["--learner.symmetry", "--learner.no-symmetry"])
def test_a_switch_can_be_given_both_ways_whatever_it_is_by_default(
    algorithm: str, flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Train] = []
    monkeypatch.setattr(Train, "run", lambda self: seen.append(self))
    assert run(Train, "training", ["--algorithm", algorithm, flag, "--out", str(tmp_path)]) == 0
    assert seen[0].learner.symmetry == (flag == "--learner.symmetry")


def test_preset_decides_defaults_and_options_override_them() -> None:
    assert Train.defaults(["--preset", "paper"]).learner == PRESETS["paper"]
    assert Train.defaults(["--preset=paper"]).preset == "paper"
    assert Train.defaults(["--space", "anchor"]).learner == PRESETS["tuned"]


def test_a_policy_is_named_for_what_is_changed_in_its_learner() -> None:
    own = learner_for("clasp", "tuned")
    changed = dataclasses.replace(own, updates=5, practice=0.3, symmetry=True, hidden=(64, 64))
    config = Train(out=Path("x"), algorithm="clasp", seed=3, learner=changed)
    assert (
        config.policy_name("clasp")
        == "clasp-tuned-anchor-mujoco-s3-hidden=64x64-practice=0.3-symmetry=true"
    )
    assert config.policy_name("bc") == "bc-tuned-anchor-mujoco-s3-hidden=64x64-symmetry=true"
    plain = Train(out=Path("x"), algorithm="clasp", task="capture")
    assert plain.policy_name("clasp") == "clasp-tuned-capture-anchor-mujoco-s0"


def test_a_learner_that_is_not_given_is_the_algorithms_own() -> None:
    assert Train(out=Path("x"), algorithm="clasp").learner == learner_for("clasp", "tuned")
    assert Train(out=Path("x"), algorithm="rlpd", preset="paper").learner == learner_for(
        "rlpd", "paper"
    )
    assert Train(out=Path("x"), algorithm="clasp", learner=Learner()).learner == Learner()


def test_what_an_algorithm_has_of_its_own_for_a_task() -> None:
    assert (
        Train.defaults(["--task", "capture-drift", "--algorithm", "clasp"]).learner.discount
        == 0.997
    )
    assert (
        Train.defaults(
            ["--task", "capture", "--algorithm", "clasp", "--preset", "paper"]
        ).learner.discount
        == 0.99
    )
    assert Train.defaults(["--task=capture"]).learner == PRESETS["tuned"]
    assert learner_for("clasp", "tuned", "follow-line").anchor_floor == 0.7
    assert learner_for("clasp", "tuned", "precise") == learner_for("clasp", "tuned")
