"""A job: its training, and what it leaves of that beside the results."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.tiny import TINY_BUDGET, tiny_job
from training.policy import load_policy
from training.run import trainer
from training.run.train_options import Train
from training.study.execute import evaluations, jobs
from training.study.execute.evaluations import EPISODE_COLUMNS, Evaluation


class StopError(Exception):
    """Instead of training."""


@pytest.mark.parametrize(("updates", "every"), [(60, 20), (800, 20), (840, 21), (100_000, 2_500)])
def test_a_learning_curve_has_forty_points_at_most(
    updates: int, every: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Train] = []

    def stop(config: Train) -> None:
        asked.append(config)
        raise StopError

    monkeypatch.setattr(trainer, "train", stop)
    job = replace(
        tiny_job(updates),
        budget=replace(TINY_BUDGET, episodes=2, evaluate_every=20, validation_episodes=3),
    )
    with pytest.raises(StopError):
        jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    (config,) = asked
    assert (config.evaluate_every, config.evaluate_episodes) == (every, 3)
    assert config.out == tmp_path / "runs" / job.name


def test_the_record_is_of_the_run_and_its_curve_is_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = ("mujoco", "anchor", "nominal", 0, 0, 1, 100, 0.02)
    monkeypatch.setattr(
        evaluations,
        "EVALUATIONS",
        {"nominal": Evaluation(EPISODE_COLUMNS, lambda _, num: iter([row] * num))},
    )
    job = tiny_job()
    job = replace(job, budget=replace(TINY_BUDGET, episodes=1))
    jobs.carry_out(job, tmp_path / "runs", tmp_path / "results")
    out, folder = tmp_path / "runs" / job.name, tmp_path / "results" / job.name
    policy, record = load_policy(out), json.loads((folder / "run.json").read_text("utf-8"))
    assert record["policy"] == policy.digest
    assert 0 < record["minutes"] == policy.card["minutes"]
    assert (record["updates"], record["environment_steps"]) == (60, 60 * 4)
    assert (folder / "metrics.csv").read_bytes() == (out / "metrics.csv").read_bytes()
