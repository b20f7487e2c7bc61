"""The grid of experiments: names, seeds, lengths, and that recorded runs still belong to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.tiny import TINY_BUDGET, tiny_changes
from training.algorithms.registry import numbers_of
from training.config.run_description import RunDescription
from training.run.train_options import train_options
from training.study.declare.budgets import BUDGETS, Budget
from training.study.declare.grid import EXPERIMENTS, collect, expected
from training.study.execute.jobs import Job
from training.study.lines import read_lines

RECORDS = Path(__file__).parents[4] / "results" / "runs.jsonl"
RETIRED = ("step_cost", "final_learning_rate", "scaled_values", "target_choice", "keep_successes")
"""Options that were tried without gain and removed. The records of those trials are kept."""


def test_a_job_is_read_back_as_it_was_written() -> None:
    spec = RunDescription(algorithm="batd3", seed=3, randomize=0.5, changes=tiny_changes("batd3"))
    job = Job(spec, ("nominal", "follow"), TINY_BUDGET)
    assert Job.from_json(job.to_json()) == job


def test_changes_and_counts_reach_the_training_run() -> None:
    spec = RunDescription(
        algorithm="td3", num_demonstrations=5, updates=77, seed=2, changes=(("critics", 3),)
    )
    config, numbers = train_options(spec, Path("x")), numbers_of(spec).model_dump()
    assert (config.num_demonstrations, config.seed) == (5, 2)
    assert (numbers["updates"], numbers["critics"]) == (77, 3)
    assert config.learner == numbers_of(spec)


@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
def test_every_experiment_has_a_summary_and_each_seed(budget: Budget) -> None:
    names = expected(budget)
    for experiment, runs in names.items():
        assert EXPERIMENTS[experiment].summary.endswith(".")
        assert len(runs) == len(set(runs))
        cells = collect([experiment], budget)
        others = {
            "transfer": range(1, budget.own_seeds + 1),
            "more-seeds": range(budget.seeds, budget.seeds + 5),
        }
        seeds = {spec.seed for spec, _ in cells.values()}
        assert seeds == set(others.get(experiment, range(budget.seeds)))
        trained = [spec for spec, _ in cells.values() if spec.trains]
        lengths = {spec.updates / budget.length(spec.preset) for spec in trained}
        assert lengths == {"longer": {4}, "moving": {1, 4}, "rivals": {1, 4}}.get(experiment, {1})
    order = [spec.seed for spec, _ in collect(list(EXPERIMENTS), budget).values()]
    assert order == sorted(order)


@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
def test_a_run_of_two_experiments_comes_once_with_the_evaluations_of_both(budget: Budget) -> None:
    names = expected(budget)
    both = collect(["table2", "table4"], budget)
    assert sorted(both) == sorted({*names["table2"], *names["table4"]})
    shared = f"batd3-tuned_spatter_mujoco_d10_u{budget.updates}_s0"
    assert both[shared][1] == ("nominal", "disturbances")
    alone = collect(["table3"], budget)
    assert {evaluations for _, evaluations in alone.values()} == {("nominal", "workspace")}


def test_the_demonstrator_runs_once_and_methods_run_with_every_seed() -> None:
    seeds: dict[str, list[int]] = {}
    for spec, _ in collect(["table2"], BUDGETS["standard"]).values():
        seeds.setdefault(spec.algorithm, []).append(spec.seed)
    assert (seeds.pop("jacobian"), seeds.pop("nearest")) == ([0], [0])
    assert all(sorted(found) == [0] * 3 + [1] * 3 + [2] * 3 for found in seeds.values())


def test_methods_come_in_the_order_in_which_they_are_compared_most() -> None:
    runs = collect(["table2"], BUDGETS["quick"]).values()
    assert [spec.algorithm for spec, _ in runs] == [
        "jacobian",
        "nearest",
        *("batd3", "bc", "clasp", "td3wd", "rlpd", "rbl", "drldr", "td3", "her") * 3,
    ]


def test_seeds_of_the_study_of_transfer_have_demonstrations_of_their_own() -> None:
    runs = [spec for spec, _ in collect(["transfer"], BUDGETS["standard"]).values()]
    assert {(run.seed, run.demonstration_seed) for run in runs} == {(i, i) for i in range(1, 6)}
    assert {run.backend for run in runs} == {
        "mujoco",
        "pybullet",
        "mujoco-stock",
        "mujoco+mujoco-stock",
    }
    others = [spec for spec, _ in collect(["table2"], BUDGETS["standard"]).values()]
    assert {(run.backend, run.demonstration_seed) for run in others} == {("mujoco", 0)}


def test_every_recorded_run_is_declared_unless_its_option_is_retired() -> None:
    declared = {name for budget in BUDGETS.values() for name in collect([*EXPERIMENTS], budget)}
    recorded = {str(record["name"]) for record in read_lines(RECORDS)}
    undeclared = recorded - declared
    assert len(recorded & declared) > 500
    former = {run for run in undeclared if "_pybullet-former_" in run}
    assert len(former) == 91
    assert len(undeclared - former) == 18
    assert all(any(name in run for name in RETIRED) for run in undeclared - former)
