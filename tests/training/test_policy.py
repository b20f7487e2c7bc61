"""Policies as files: a saved policy acts alike; damaged files are refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, sealed, write_json
from cdcsr.robot.description import load_robot
from cdcsr.tasks.observation import observation_size
from training.measure.evaluation import evaluate
from training.networks.actor import Actor
from training.policy import Policy, find_policy, load_policy


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    robot = load_robot("planar-single")
    torch.manual_seed(0)
    card = {"name": "test", "frame_skip": 2, "backend": "mujoco", "space": "anchor"}
    Policy(Actor(robot, True, (8, 8), "relu"), robot, np.ones((2, 3)), card).save(
        tmp_path / "policy"
    )
    return tmp_path / "policy"


def test_loaded_policy_acts_like_the_saved(folder: Path) -> None:
    robot = load_robot("planar-single")
    torch.manual_seed(0)
    actor, policy = Actor(robot, True, (8, 8), "relu"), load_policy(folder)
    observation = torch.randn(5, observation_size(robot))
    torch.testing.assert_close(
        policy.actor.command(observation), actor.command(observation), rtol=0, atol=0
    )
    assert policy.robot == robot
    assert policy.frame_skip == 2
    np.testing.assert_array_equal(policy.centers, np.ones((2, 3)))


def test_a_policy_takes_one_observation_or_many(folder: Path) -> None:
    """Its commands are those of the trained network; a mistake is one line."""
    policy, size = load_policy(folder), observation_size(load_robot("planar-single"))
    many = np.random.default_rng(0).normal(size=(5, size))
    expected = policy.actor.command(torch.as_tensor(many, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(policy(many), expected, rtol=1e-6)
    assert policy(many[2]).shape == (policy.robot.num_cables,)
    np.testing.assert_allclose(policy(many[2].tolist()), expected[2], rtol=1e-5)
    for wrong in (many[:, :-1], many[None], 1.0):
        with pytest.raises(CdcsrError, match="observation must have the shape"):
            policy(wrong)
    with pytest.raises(CdcsrError, match="observation must be finite"):
        policy(np.full(size, np.nan))


def test_a_policy_knows_its_start_and_older_ones_began_still(folder: Path) -> None:
    assert load_policy(folder).start == "still"
    _edit("start", "moving")(folder)
    assert load_policy(folder).start == "moving"
    assert find_policy("clasp-anchor-mujoco").start == "still"


def test_a_policy_refuses_another_robot(folder: Path) -> None:
    with pytest.raises(CdcsrError, match=r"is for robot 'planar-single' .* not for 'paper'"):
        evaluate(load_policy(folder), load_robot("paper"), "mujoco", "anchor", episodes=1)


def _cut_weights(folder: Path) -> None:
    path = folder / "policy.safetensors"
    path.write_bytes(path.read_bytes()[:-40])


def _noise(folder: Path) -> None:
    (folder / "policy.safetensors").write_bytes(b"not weights")


def _no_json(folder: Path) -> None:
    (folder / "policy.json").write_text("{")


def _list_json(folder: Path) -> None:
    (folder / "policy.json").write_text("[1, 2]")


def _edit(key: str, value: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        card = read_json(folder / "policy.json")
        card[key] = value
        write_json(folder / "policy.json", sealed(card))

    change.__name__ = f"edit_{key}"
    return change


@pytest.mark.parametrize(
    "damage",
    [
        _cut_weights,
        _noise,
        _no_json,
        _list_json,
        _edit("network", {"with_error": True, "hidden": [8, 9], "activation": "relu"}),
        _edit("network", {"with_error": True, "hidden": ["8"], "activation": "relu"}),
        _edit("centers", "here"),
        _edit("robot_fingerprint", "0"),
        _edit("format", 99),
        _edit("robot_description", "name = 3"),
        _edit("frame_skip", None),
    ],
)
def test_damage_is_one_clear_line(folder: Path, damage: Callable[[Path], None]) -> None:
    damage(folder)
    with pytest.raises(CdcsrError) as caught:
        load_policy(folder)
    assert "\n" not in str(caught.value)


def test_missing_policy_lists_those_there_are() -> None:
    with pytest.raises(CdcsrError, match=r"Unknown policy 'nothing'.* Or give the folder"):
        find_policy("nothing")


def test_a_folder_without_policy_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"policy\.json and policy\.safetensors are needed"):
        load_policy(tmp_path)
