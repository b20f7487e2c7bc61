"""Mapping a workspace: what is in the map is reached."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names
from cdcsr.tasks.spaces import make_space
from controllers.jacobian import JacobianController
from controllers.rollout import rollout
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


@pytest.mark.parametrize("backend", backend_names())
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


def test_mistakes_are_told(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"A map is an \.npz file, not 'map\.png'"):
        workspace("paper", out=tmp_path / "map.png")
    with pytest.raises(CdcsrError, match=r"spacing must be a number from \d+\.\d+ to \d+"):
        workspace("paper", out=tmp_path / "map.npz", spacing=0)
    with pytest.raises(CdcsrError, match="no whole cell between them"):
        workspace("planar-single", out=tmp_path / "map.npz", spacing=2.0)
    assert list(tmp_path.iterdir()) == []
