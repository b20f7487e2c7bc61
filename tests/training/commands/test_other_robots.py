"""Commands refuse a policy or a dataset on another robot, and tell of unfinished policies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, sealed, write_json
from cdcsr.robot.description import load_robot
from training.commands.demonstrate import demonstrate
from training.commands.evaluate import evaluate
from training.commands.measured import find_controller
from training.commands.replay import replay
from training.commands.search import search
from training.commands.sweep import sweep
from training.commands.transfer import transfer
from training.networks.actor import Actor
from training.policy import Policy


@pytest.fixture
def heavier(tmp_path: Path) -> str:
    """A description of the name of a shipped robot, with other numbers."""
    path = tmp_path / "planar-single.toml"
    text = load_robot("planar-single").to_toml()
    path.write_text(text.replace("time_step = 0.0025", "time_step = 0.002"))
    return str(path)


@pytest.fixture
def own(tmp_path: Path) -> str:
    """The folder of a policy of the shipped one."""
    robot = load_robot("planar-single")
    card = {"name": "own", "frame_skip": 25, "backend": "mujoco", "space": "anchor"}
    Policy(Actor(robot, False, (4,), "relu"), robot, np.ones((1, 3)), card).save(tmp_path / "own")
    return str(tmp_path / "own")


@pytest.mark.parametrize(
    "command",
    [
        lambda policy, robot, _: evaluate(policy, robot=robot, episodes=1),
        lambda policy, robot, _: transfer([policy], robot=robot, episodes=1),
        lambda policy, robot, _: sweep(policy, robot=robot, episodes=1),
        lambda policy, robot, out: search(policy, robot=robot, episodes=1, rounds=1, out=out),
    ],
    ids=["evaluate", "transfer", "sweep", "search"],
)
def test_a_policy_is_refused_on_another_robot_by_what_differs(
    tmp_path: Path, own: str, heavier: str, command: Callable[[str, str, Path], None]
) -> None:
    with pytest.raises(CdcsrError, match=r"time_step = 0\.0025, not 0\.002\); leave --robot out"):
        command(own, heavier, tmp_path / "out")


def test_a_policy_of_another_robot_than_paper_needs_no_option(
    own: str, capsys: pytest.CaptureFixture[str]
) -> None:
    transfer([own, "jacobian"], backend="mujoco", space="anchor", episodes=1)
    evaluate(own, backend="mujoco", robot="planar-single", episodes=1)
    assert "jacobian in mujoco, anchor" in capsys.readouterr().out


def test_a_dataset_is_replayed_on_its_own_robot(tmp_path: Path, heavier: str) -> None:
    demonstrate(out=tmp_path / "set", robot=heavier, episodes=1, frame_skip=10)
    (tmp_path / "planar-single.toml").unlink()
    replay(tmp_path / "set", backend="mujoco", frame_skip=10, json=tmp_path / "replay.json")
    assert '"largest_mm": 0' in (tmp_path / "replay.json").read_text()
    with pytest.raises(CdcsrError, match=r"\(time_step = 0\.002, not 0\.0025\)"):
        replay(tmp_path / "set", robot="planar-single", frame_skip=10)


def test_a_policy_computes_in_one_thread(own: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums are in another order with more of them. A scripted controller needs no torch."""
    threads: list[int] = []
    monkeypatch.setattr(torch, "set_num_threads", threads.append)
    find_controller("jacobian", load_robot("planar-single"))
    assert threads == []
    find_controller(own, load_robot("planar-single"))
    assert threads == [1]


def test_an_unfinished_policy_is_told(own: str, capsys: pytest.CaptureFixture[str]) -> None:
    robot, card = load_robot("planar-single"), Path(own) / "policy.json"
    find_controller(own, robot)
    assert "unfinished" not in capsys.readouterr().err
    write_json(card, sealed({**read_json(card), "unfinished": {"update": 1, "of": 12_000}}))
    find_controller(own, robot)
    assert "is unfinished, from update 1 of 12000" in capsys.readouterr().err


def test_a_policy_of_an_older_run_that_was_stopped_is_told(
    own: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (Path(own) / "state.safetensors").touch()
    find_controller(own, load_robot("planar-single"))
    assert "is unfinished;" in capsys.readouterr().err
