"""Demonstrations: what is recorded, that stock Minari reads it, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cdcsr.envs import ReachVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot import load_robot
from cdcsr.spaces import demonstration_targets
from controllers.commands import demonstrate
from controllers.demonstrations import load, record
from controllers.jacobian import JacobianController


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("datasets") / "reach-anchor-v0"
    demonstrate(out=out, episodes=3, seed=0, json=out.parent / "summary.json")
    return out


def test_stock_minari_reads_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder.parent))
    dataset = minari.load_dataset("reach-anchor-v0")
    assert dataset.total_episodes == 3
    for episode in dataset.iterate_episodes():
        assert episode.terminations[-1]
        assert episode.rewards.sum() == 1
        assert len(episode.observations) == len(episode.actions) + 1
    env = dataset.recover_environment()
    assert env.observation_space == dataset.observation_space


def test_replaying_the_commands_gives_the_observations(folder: Path) -> None:
    episode = load(folder, load_robot("paper").fingerprint)[1]
    env = ReachVectorEnv(1, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": episode.target[None]})
    np.testing.assert_array_equal(observation[0], episode.observations[0])
    for action, expected in zip(episode.actions, episode.observations[1:], strict=True):
        observation, *_ = env.step(action[None])
        np.testing.assert_array_equal(observation[0], expected)
    assert observation[0, 9] <= 0.03


def test_targets_are_those_of_the_seed(folder: Path) -> None:
    robot = load_robot("paper")
    episodes = load(folder, robot.fingerprint)
    np.testing.assert_array_equal([e.target for e in episodes], demonstration_targets(robot, 3, seed=0))
    summary = json.loads((folder.parent / "summary.json").read_text())
    assert summary["steps"] == sum(e.length for e in episodes)


def test_failed_episodes_are_drawn_anew() -> None:
    env = ReachVectorEnv(4, max_steps=110, autoreset_mode="Disabled")  # too short for about half the targets
    episodes, failed = record(JacobianController(env.robot), env, num=6, seed=0)
    assert failed > 0
    assert len(episodes) == 6
    assert all(e.observations[-1, 9] <= 0.03 and e.length <= 110 for e in episodes)


def test_a_hopeless_space_is_an_error() -> None:
    env = ReachVectorEnv(4, max_steps=5, autoreset_mode="Disabled")
    with pytest.raises(CdcsrError, match=r"reached 0 of \d+ targets"):
        record(JacobianController(env.robot), env, num=2, seed=0)


def test_existing_folder_is_kept(folder: Path) -> None:
    before = (folder / "data" / "main_data.hdf5").read_bytes()
    with pytest.raises(CdcsrError, match="already exists"):
        demonstrate(out=folder, episodes=1)
    assert (folder / "data" / "main_data.hdf5").read_bytes() == before


def test_what_is_no_dataset_is_refused(tmp_path: Path, folder: Path) -> None:
    fingerprint = load_robot("paper").fingerprint
    with pytest.raises(CdcsrError, match="holds no demonstrations"):
        load(tmp_path, fingerprint)
    with pytest.raises(CdcsrError, match="are of robot 'paper'"):
        load(folder, load_robot("three-cable").fingerprint)
    with pytest.raises(CdcsrError, match="frame_skip 1, not 2"):
        load(folder, fingerprint, frame_skip=2)
