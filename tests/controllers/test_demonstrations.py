"""Demonstrations: what is recorded, that stock Minari reads it, and what is refused."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.observation import SLICES, TARGET
from cdcsr.tasks.spaces import demonstration_targets
from cdcsr.tasks.workspace_map import Workspace, load_workspace
from controllers.dataset_files import stored_robot
from controllers.demonstrations import load, record
from controllers.jacobian import JacobianController
from tests.support.tiny import tiny_changes
from training.commands.demonstrate import demonstrate
from training.commands.replay import replay
from training.run.train_options import Train
from training.run.trainer import train


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("datasets") / "reach-anchor-v0"
    demonstrate(out=out, episodes=3, seed=0, json=out.parent / "summary.json")
    return out


@pytest.fixture
def small_map(tmp_path: Path) -> Path:
    """A map of two cells of the small robot."""
    robot, path = load_robot("planar-single"), tmp_path / "own.npz"
    cells = np.array([[0, 0, 0], [0, 0, 1]], dtype=np.int16)
    corner = np.array(robot.workspace.center)
    edges = np.array([0.02, 0.0, 0.02])
    Workspace(robot.fingerprint, corner, edges, cells, robot.to_toml()).save(path)
    return path


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


def test_minaris_own_tools_take_datasets_of_ones_own_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two datasets of a robot of the name `paper` that is not the shipped one."""
    import minari
    from minari.cli import app
    from typer.testing import CliRunner

    own = tmp_path / "own.toml"
    own.write_text(load_robot("paper").to_toml().replace("mass = 1.18", "mass = 0.6"))
    robot = load_robot(own)
    assert robot.fingerprint != load_robot("paper").fingerprint
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    for place, seed in (("one-v0", 0), ("lab/two-v1", 1)):
        out = tmp_path / "sets" / place
        demonstrate(out=out, episodes=1, frame_skip=10, robot=str(own), seed=seed)
    with pytest.raises(CdcsrError, match=r"give --out .*sets/demos-v0"):
        demonstrate(out=tmp_path / "sets" / "demos", episodes=1)
    shown = CliRunner().invoke(app, ["list", "local"], env={"COLUMNS": "200"})
    assert "one-v0" in shown.output
    assert "lab/two-v1" in shown.output
    assert CliRunner().invoke(app, ["show", "lab/two-v1"]).exit_code == 0
    sets = [minari.load_dataset(name) for name in ("one-v0", "lab/two-v1")]
    assert [one.spec.dataset_id for one in sets] == ["one-v0", "lab/two-v1"]
    both = minari.combine_datasets(sets, "both-v0")
    for one in (*sets, both):
        env = one.recover_environment()
        assert env.unwrapped.batch.robot == robot  # type: ignore[attr-defined]
        env.close()
    read = load(tmp_path / "sets" / "both-v0", robot.fingerprint, 10)
    assert [e.length for e in read] == [len(e.actions) for one in sets for e in one]


def recorded_by_minari(name: str, env_id: str, **options: object) -> Path:
    """Record two episodes of random actions as stock Minari does; return the folder."""
    import minari
    from minari.data_collector import EpisodeBuffer

    env = gymnasium.make(env_id, **options)  # type: ignore[arg-type]
    env.action_space.seed(0)
    buffers = []
    for number in range(2):
        observations, steps = [env.reset(seed=number)[0]], []
        while not steps or not (steps[-1][2] or steps[-1][3]):
            action = env.action_space.sample()
            observation, *outcome, _ = env.step(action)
            observations.append(observation)
            steps.append((action, *outcome))
        names = ("actions", "rewards", "terminations", "truncations")
        columns = (list(column) for column in zip(*steps, strict=True))
        of_steps: dict[str, Any] = dict(zip(names, columns, strict=True))
        buffers.append(EpisodeBuffer(id=number, observations=observations, **of_steps))
    with warnings.catch_warnings():  # of authors and links that are not given
        warnings.simplefilter("ignore", UserWarning)
        minari.create_dataset_from_buffers(name, buffers, env=env)
    env.close()
    return Path(os.environ["MINARI_DATASETS_PATH"]) / name


def test_what_stock_minari_recorded_is_learnt_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its environment says of which robot and task it is; what it leaves out is as usual."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    small = {"robot": "planar-single", "frame_skip": 10}
    folder = recorded_by_minari("random-v0", "cdcsr/Reach-v0", **small)
    run = Train(
        out=tmp_path / "run",
        demonstrations=folder,
        robot="planar-single",
        algorithm="batd3",
        changes=tiny_changes("batd3", bc_updates=20),
        frame_skip=10,
        space="spatter",
        updates=20,
        evaluate_every=20,
        evaluate_episodes=1,
    )
    policy = train(run)
    read = load(folder, load_robot("planar-single").fingerprint, 10, "reach", "still", 0.03)
    np.testing.assert_array_equal(policy.centers, [episode.target for episode in read])
    assert "no digests" in capsys.readouterr().err
    moving = recorded_by_minari("drift-v0", "cdcsr/Capture-v0", motion="drift", **small)
    with pytest.raises(CdcsrError, match="of the task 'capture-drift', not 'reach'"):
        load(moving, load_robot("planar-single").fingerprint, 10, "reach")
    with pytest.raises(CdcsrError, match=r"of robot 'planar-single' .*, not of the robot asked"):
        load(folder, load_robot("paper").fingerprint, 10)
    dense = recorded_by_minari("dense-v0", "cdcsr/Reach-v0", reward="dense", **small)
    with pytest.raises(CdcsrError, match="its environment was made with reward"):
        load(dense, load_robot("planar-single").fingerprint, 10)


def test_a_dataset_keeps_its_robot_and_its_map(tmp_path: Path, small_map: Path) -> None:
    import minari

    out = tmp_path / "set"
    demonstrate(out=out, episodes=1, frame_skip=10, robot="planar-single", space=str(small_map))
    robot = stored_robot(out)
    assert robot == load_robot("planar-single")
    env = minari.MinariDataset(out / "data").recover_environment().unwrapped
    ours = load_workspace(load_robot("planar-single"), small_map).sample(
        np.random.default_rng(0), 5
    )
    space = env.batch._episodes.space  # type: ignore[attr-defined]
    theirs = space.sample(np.random.default_rng(0), 5)
    np.testing.assert_array_equal(ours, theirs)
    env.close()


def test_damage_is_seen_and_datasets_without_digests_are_read(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fingerprint = load_robot("paper").fingerprint
    for name in ("main_data.hdf5", "metadata.json"):
        shutil.copytree(folder, tmp_path / name)
        path = tmp_path / name / "data" / name
        data = path.read_bytes()
        at = data.index(load(folder, fingerprint)[1].actions.tobytes()[:8]) if "5" in name else 0
        at = at or data.index(b"mass = 1.18") + 7
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(CdcsrError, match="is damaged"):
            load(tmp_path / name, fingerprint)
    path = folder / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    shutil.copytree(folder, tmp_path / "old")
    for key in ("digest", "data_digest", "robot_description"):
        del metadata[key]
    (tmp_path / "old" / "data" / "metadata.json").write_text(json.dumps(metadata))
    capsys.readouterr()
    assert len(load(tmp_path / "old", fingerprint)) == 3
    assert "older version" in capsys.readouterr().err


def test_replaying_the_commands_gives_the_observations(folder: Path) -> None:
    episode = load(folder, load_robot("paper").fingerprint)[1]
    env = TaskVectorEnv(1, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": episode.target[None]})
    np.testing.assert_array_equal(observation[0], episode.observations[0])
    for action, expected in zip(episode.actions, episode.observations[1:], strict=True):
        observation, *_ = env.step(action[None])
        np.testing.assert_array_equal(observation[0], expected)
    assert observation[0, 9] <= 0.03


def test_any_task_and_frame_skip_is_replayed(tmp_path: Path) -> None:
    record = tmp_path / "record.json"
    demonstrate(
        out=tmp_path / "quiet", episodes=1, seed=0, frame_skip=5, task="precise", json=record
    )
    (episode,) = load(tmp_path / "quiet", load_robot("paper").fingerprint, 5)
    assert json.loads(record.read_text())["steps"] == 5 * len(episode.actions)  # the simulation's
    with pytest.raises(CdcsrError, match="have frame_skip 5, not 1"):
        replay(tmp_path / "quiet", backend="mujoco")
    replay(tmp_path / "quiet", backend="mujoco", frame_skip=5, json=tmp_path / "replay.json")
    assert json.loads((tmp_path / "replay.json").read_text())[0]["largest_mm"] == 0


def test_targets_are_those_of_the_seed(folder: Path) -> None:
    robot = load_robot("paper")
    episodes = load(folder, robot.fingerprint)
    np.testing.assert_array_equal(
        [e.target for e in episodes], demonstration_targets(robot, 3, seed=0)
    )
    summary = json.loads((folder.parent / "summary.json").read_text())
    assert summary["steps"] == sum(e.length for e in episodes)


def test_failed_episodes_are_drawn_anew() -> None:
    env = TaskVectorEnv(
        4, max_steps=110, autoreset_mode="Disabled"
    )  # too short for about half the targets
    episodes, failed, _ = record(JacobianController(env.robot), env, num=6, seed=0)
    assert failed > 0
    assert len(episodes) == 6
    assert all(e.observations[-1, 9] <= 0.03 and e.length <= 110 for e in episodes)


def test_a_hopeless_space_is_an_error() -> None:
    env = TaskVectorEnv(4, max_steps=5, autoreset_mode="Disabled")
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
    with pytest.raises(
        CdcsrError, match=r"of the task 'reach', not 'capture'; .*cdcsr demonstrate --task capture"
    ):
        load(folder, fingerprint, task="capture")


def test_demonstrations_begin_as_asked_and_are_replayed_only_from_still(tmp_path: Path) -> None:
    """A replay cannot know how the arm was bent."""
    folder = tmp_path / "set"
    demonstrate(out=folder, episodes=2, start="moving")
    episodes = load(folder, load_robot("paper").fingerprint, start="moving")
    for episode in episodes:
        moved = np.diff(episode.observations[:, TARGET], axis=0)
        drift = episode.observations[0, SLICES["base_velocity"]] * 0.0025
        assert np.linalg.norm(drift) > 1e-6
        np.testing.assert_allclose(moved, np.broadcast_to(drift, moved.shape), atol=1e-12)
    with pytest.raises(CdcsrError, match=r"begin 'moving', .*cdcsr demonstrate --start still"):
        replay(folder)


def test_a_capture_is_demonstrated_and_read_back(tmp_path: Path) -> None:
    """The last 20 actions, of two steps each, left the tip on the target; the last is rewarded."""
    demonstrate(out=tmp_path / "set", episodes=2, task="capture-drift", frame_skip=2)
    episodes = load(
        tmp_path / "set", load_robot("paper").fingerprint, frame_skip=2, task="capture-drift"
    )
    for episode in episodes:
        assert episode.terminated
        assert episode.rewards.tolist() == [0.0] * (episode.length - 1) + [1.0]
        assert (episode.observations[-20:, 9] <= 0.03).all()
        moved = np.diff(episode.observations[:, TARGET], axis=0)
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-12)
        np.testing.assert_array_equal(episode.target, episode.observations[0, TARGET])


def test_a_follower_is_demonstrated_to_the_end_of_time(tmp_path: Path) -> None:
    demonstrate(out=tmp_path / "set", episodes=1, task="follow-line", frame_skip=10)
    (episode,) = load(
        tmp_path / "set", load_robot("paper").fingerprint, frame_skip=10, task="follow-line"
    )
    assert not episode.terminated
    assert episode.length == 100
    np.testing.assert_array_equal(episode.rewards, episode.observations[1:, 9] <= 0.03)
    assert episode.rewards[25:].mean() >= 0.9
