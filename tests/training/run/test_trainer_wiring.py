"""A training run hands on each of its options, and one process at a time holds its folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, sealed, write_json
from cdcsr.locks import Busy, lock
from cdcsr.simulation.randomization import Randomization
from cdcsr.tables import csv_text, read_csv_rows
from tests.support.tiny import FRAME_SKIP, tiny_changes
from training.config.seeds import EVALUATION_SEEDS, TEST_SEED, VALIDATION_SEED
from training.experience.collector import Collector, FinishedEpisode
from training.networks.actor import Actor
from training.policy import load_policy
from training.run import trainer
from training.run.metrics import COLUMNS, Metrics, read_metrics
from training.run.train_options import Train
from training.run.trainer import train


def config(
    out: Path,
    demonstrations: Path,
    *,
    algorithm: str = "batd3",
    numbers: dict[str, object] | None = None,
    **options: Any,
) -> Train:
    usual = {"space": "spatter", "frame_skip": FRAME_SKIP, "evaluate_every": 0, "updates": 61}
    return Train(
        out=out,
        demonstrations=demonstrations,
        evaluate_episodes=2,
        algorithm=algorithm,
        changes=tiny_changes(algorithm, **(numbers or {})),
        **{**usual, **options},
    )


class Watched(Collector):
    """Remembers how it was used."""

    seen: list[Watched]

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.actors: list[Actor] = []
        Watched.seen.append(self)

    def start(self, seed: int) -> None:
        self.seed = seed
        super().start(seed)

    def step(self, actor: Actor) -> Iterator[FinishedEpisode]:
        self.actors.append(actor)
        return super().step(actor)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> list[Watched]:
    Watched.seen = []
    monkeypatch.setattr(trainer, "Collector", Watched)
    return Watched.seen


def test_seed_plants_start_and_updates_for_each_step_arrive(
    tmp_path: Path, demonstrations: Path, watched: list[Watched]
) -> None:
    policy = train(
        config(
            tmp_path / "run",
            demonstrations,
            algorithm="td3",
            start="anywhere",
            seed=5,
            randomize=1.0,
            numbers={"updates_per_step": 3},
        )
    )
    (collector,) = watched
    assert collector.seed == 5
    assert isinstance(collector.env.randomization, Randomization)
    assert collector.env.start == policy.start == load_policy(tmp_path / "run").start == "anywhere"
    assert len(collector.actors) == 21  # for 61 updates, 3 for each step


def test_the_actor_explores_and_its_average_is_kept(
    tmp_path: Path, demonstrations: Path, watched: list[Watched]
) -> None:
    policy = train(config(tmp_path / "run", demonstrations, algorithm="td3"))
    explored, kept = (dict(one.state_dict()) for one in (watched[0].actors[-1], policy.actor))
    assert any(not torch.equal(explored[name], kept[name]) for name in kept)
    last: dict[str, object] = {"averaged_policy": False}
    policy = train(config(tmp_path / "last", demonstrations, algorithm="td3", numbers=last))
    explored, kept = (dict(one.state_dict()) for one in (watched[1].actors[-1], policy.actor))
    assert all(torch.equal(explored[name], kept[name]) for name in kept)


def test_the_average_starts_from_the_clone_as_the_actor_does(
    tmp_path: Path, demonstrations: Path
) -> None:
    still = {"clone_start": True, "clone_anchor": 0.5, "learning_rate": 1e-30, "soft_update": 1e-30}
    weights = []
    for averaged in (True, False):
        numbers: dict[str, object] = {**still, "averaged_policy": averaged}
        run = config(
            tmp_path / str(averaged), demonstrations, algorithm="clasp", updates=3, numbers=numbers
        )
        train(run)
        weights.append(load_file(tmp_path / str(averaged) / "policy.safetensors"))
    for name in weights[0]:
        torch.testing.assert_close(weights[0][name], weights[1][name])


def test_no_run_learns_on_targets_that_are_for_measuring(tmp_path: Path) -> None:
    assert {TEST_SEED, VALIDATION_SEED} == EVALUATION_SEEDS.keys()
    for seed in EVALUATION_SEEDS:
        with pytest.raises(CdcsrError, match=f"seed {seed} draws the .* targets"):
            Train(out=tmp_path / "run", seed=seed)


@pytest.mark.parametrize("content", [None, "[]", '{"mine": 1}'])
def test_force_takes_no_folder_that_is_not_of_a_run(
    tmp_path: Path, demonstrations: Path, content: str | None
) -> None:
    folder = tmp_path / "project"
    (folder / "tensorboard").mkdir(parents=True)
    files = {"summary.json": "mine", "tensorboard/events.mine": "mine"}
    files |= {} if content is None else {"config.json": content}
    for name, text in files.items():
        (folder / name).write_text(text)
    with pytest.raises(CdcsrError, match=r"not a training run|should hold a JSON object"):
        train(config(folder, demonstrations, force=True))
    assert {name: (folder / name).read_text() for name in files} == files
    (tmp_path / "file").write_text("mine")
    with pytest.raises(CdcsrError, match="exists and is not a training run"):
        train(config(tmp_path / "file", demonstrations, force=True))


def test_one_process_at_a_time(tmp_path: Path, demonstrations: Path) -> None:
    run = config(tmp_path / "run", demonstrations, algorithm="bc")
    train(run)
    before = (tmp_path / "run" / "policy.safetensors").read_bytes()
    with lock(tmp_path / "run" / ".lock"), pytest.raises(Busy, match="held by the live process"):
        train(dataclasses.replace(run, force=True))
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == before
    assert not (tmp_path / "run" / ".lock").exists()


def test_a_state_left_by_a_kill_at_the_very_end_goes(tmp_path: Path, demonstrations: Path) -> None:
    run = config(tmp_path / "run", demonstrations, algorithm="td3")
    train(run)
    (tmp_path / "run" / "state.safetensors").write_bytes(b"left")
    train(run)
    assert not (tmp_path / "run" / "state.safetensors").exists()


def test_rows_after_the_checkpoint_go_and_those_before_stay_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "metrics.csv"
    rows = [
        [*("20", "80", "0.1", "", "0.25"), *[""] * 8],
        [*("40", "160", "0.2", "", "0.5"), *[""] * 8],
        [*("60", "240", "0.3", "", "0.75"), *[""] * 8],
    ]
    path.write_text(csv_text(COLUMNS, rows))

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            Metrics(tmp_path, after=40)
    assert [row["update"] for row in read_metrics(path)] == [20, 40, 60]  # nothing is lost
    Metrics(tmp_path, after=40)
    assert read_csv_rows(path) == ([*COLUMNS], rows[:2])


@pytest.mark.parametrize("damage", ["update\nx\n", "other\n1\n", "update\n1,2\n", "\udcff"])
def test_damaged_metrics_are_said_to_be(tmp_path: Path, damage: str) -> None:
    (tmp_path / "metrics.csv").write_bytes(damage.encode("utf-8", "surrogateescape"))
    with pytest.raises(CdcsrError, match=r"metrics\.csv( is damaged|: it is not UTF-8)"):
        Metrics(tmp_path, after=40)


@pytest.mark.parametrize("change", ["space", "backend", "centers", "activation"])
def test_a_card_that_lacks_something_is_damaged(
    tmp_path: Path, demonstrations: Path, change: str
) -> None:
    folder = tmp_path / "run"
    train(config(folder, demonstrations, algorithm="bc"))
    card = read_json(folder / "policy.json")
    if change == "centers":
        card["centers"] = []
    elif change == "activation":
        card["network"]["activation"] = "gelu"
    else:
        del card[change]
    write_json(folder / "policy.json", sealed(card))
    with pytest.raises(CdcsrError, match=rf"damaged.*{change}"):
        trainer.load_policy(folder)


def test_a_replay_that_does_not_fit_into_memory_is_one_line(
    tmp_path: Path, demonstrations: Path
) -> None:
    huge: dict[str, object] = {"capacity": 10**9}
    with pytest.raises(CdcsrError, match="capacity of 1,000,000,000 rows would need about"):
        train(config(tmp_path / "run", demonstrations, algorithm="td3", numbers=huge))
