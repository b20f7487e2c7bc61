"""Mapping a workspace: what is in the map is reached."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.spaces import make_space
from controllers import workspace as mapping
from controllers.jacobian import JacobianController
from controllers.rollout import rollout
from tests.support.engines import each_engine
from training.commands.workspace import workspace


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("map")
    workspace(
        "planar-single",
        out=out / "map.npz",
        spacing=0.2,
        frame_skip=10,
        plot=out / "map.png",
        json=out / "map.json",
    )
    return out


def test_a_map_surrounds_the_anchor_space(folder: Path) -> None:
    robot = load_robot("planar-single")
    targets = make_space(str(folder / "map.npz"), robot).sample(np.random.default_rng(0), 500)
    assert targets[:, 0].min() < 0 < robot.workspace.center[0] < targets[:, 0].max()
    summary = json.loads((folder / "map.json").read_text())
    assert summary["cells"] < summary["reached"] < summary["tried"]
    assert (folder / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("backend", each_engine())
@pytest.mark.parametrize("space", ["planar-single", "workspace"])
def test_what_is_in_a_map_is_reached(folder: Path, backend: str, space: str) -> None:
    robot, path = (
        ("planar-single", str(folder / "map.npz"))
        if space == "planar-single"
        else ("paper", "workspace")
    )
    env = TaskVectorEnv(12, robot, backend, path, frame_skip=5, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=3)
    assert rollout(JacobianController(env.robot), env, observation).success.sum() >= 11
    env.close()


def test_an_interrupted_map_goes_on_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, batches = load_robot("planar-single"), 0
    monkeypatch.setattr(mapping, "BATCH", 16)

    def stop(*_: int) -> None:
        nonlocal batches
        batches += 1
        if batches == 2:
            raise KeyboardInterrupt

    record = tmp_path / "map.part"
    arguments = (robot, "mujoco", 0.2, 10)
    whole = mapping.compute_workspace(*arguments)
    with pytest.raises(KeyboardInterrupt):
        mapping.compute_workspace(*arguments, stop, record)
    with pytest.raises(CdcsrError, match="of a map with other options, which was interrupted"):
        mapping.compute_workspace(robot, "mujoco", 0.25, 10, record=record)
    again = mapping.compute_workspace(*arguments, stop, record)
    assert batches > 3
    whole.save(tmp_path / "whole.npz")
    again.save(tmp_path / "again.npz")
    assert (tmp_path / "whole.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()
    record.write_text('{"same": 1}')
    with pytest.raises(CdcsrError, match="is damaged"):
        mapping.compute_workspace(*arguments, record=record)


def test_a_map_begins_at_the_tip() -> None:
    """An Anchor Space that nothing reaches does not matter."""
    robot = load_robot("planar-single")
    beyond = robot.workspace.model_copy(update={"center": (0.1, 0.0, 3.25)})
    robot = robot.model_copy(update={"workspace": beyond})
    found = mapping.compute_workspace(robot, "mujoco", 0.2, 10)
    assert np.abs(found.centers - [0, 0, 1.5]).max(axis=1).min() <= 0.2


def test_mistakes_are_told(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"A map is an \.npz file, not 'map\.png'"):
        workspace("paper", out=tmp_path / "map.png")
    with pytest.raises(CdcsrError, match=r"spacing must be a number from \d+\.\d+ to \d+"):
        workspace("paper", out=tmp_path / "map.npz", spacing=0)
    with pytest.raises(CdcsrError, match="no whole cell between them"):
        workspace("planar-single", out=tmp_path / "map.npz", spacing=2.0)
    assert list(tmp_path.iterdir()) == []
