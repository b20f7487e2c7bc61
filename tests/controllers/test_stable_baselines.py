"""Policies of stable-baselines3 act here as they do there, and the page on controllers holds."""

from __future__ import annotations

import re
import sys
import warnings
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import cdcsr.envs  # registers the environments
from cdcsr import cli
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.observation import parts_of
from controllers import stable_baselines
from controllers.rollout import rollout
from controllers.stable_baselines import StableBaselines

sb3 = pytest.importorskip("stable_baselines3")
PAGE = Path(cdcsr.envs.__file__).parents[2] / "docs" / "your-own-controller.md"
ROBOT = load_robot("planar-single")


@pytest.mark.parametrize("name", ["SAC", "TD3", "DDPG", "PPO"])
def test_acts_as_in_stable_baselines(name: str, tmp_path: Path) -> None:
    env = gymnasium.make("cdcsr/Reach-v0", robot=ROBOT, frame_skip=25)
    model = getattr(sb3, name)("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [8]})
    model.save(tmp_path / "mine.zip")
    start = [0.1, 0.0, 1.2]
    observation, _ = env.reset(options={"target": start})
    actions = []
    for _ in range(4):
        action, _ = model.predict(observation, deterministic=True)
        actions.append(action)
        observation, *_ = env.step(action)
    env.close()
    batch = TaskVectorEnv(2, ROBOT, frame_skip=25, autoreset_mode="Disabled")
    first, _ = batch.reset(options={"targets": np.array([start, [0.3, 0.0, 1.0]])})
    controller = StableBaselines(tmp_path / "mine.zip")
    done = rollout(controller, batch, first)
    batch.close()
    assert controller.name == "mine"
    assert np.abs(actions).max() > 0
    np.testing.assert_allclose(done.actions[0, :4], actions, rtol=1e-4, atol=1e-6)


def test_the_commands_take_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = gymnasium.make("cdcsr/Reach-v0", robot=ROBOT)
    model = sb3.SAC("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [8]})
    model.save(tmp_path / "mine.zip")
    asked = ["evaluate", str(tmp_path / "mine.zip"), "--episodes", "1", "--backend", "mujoco"]
    assert cli.main([*asked, "--robot", "planar-single"]) == 0
    assert "| mine " in capsys.readouterr().out
    assert cli.main(asked) == 2
    assert "has observations and actions of shapes (27,) and (4,)" in capsys.readouterr().err


def test_bad_files_and_a_missing_package_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken.zip"
    broken.write_bytes(b"not a zip")
    with pytest.raises(CdcsrError, match="holds no policy of stable-baselines3"):
        StableBaselines(broken)
    with pytest.raises(CdcsrError, match=r"Cannot read the policy .*: No such file"):
        StableBaselines(tmp_path / "nothing.zip")
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(CdcsrError, match="pip install stable-baselines3"):
        StableBaselines(broken)


def test_a_bomb_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stable_baselines, "MOST_TABLE", 1_000_000)
    inner, zeros = tmp_path / "inner.pth", bytes(2_000_000)
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data.pkl", zeros)
    for number, (name, content) in enumerate([("data", zeros), ("policy.pth", inner.read_bytes())]):
        path = tmp_path / f"{number}.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(name, content)
        assert path.stat().st_size < 10_000
        with pytest.raises(CdcsrError, match="unpacks to more than 1,000,000 bytes"):
            StableBaselines(path)


def test_the_snippets_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own, training, wrapped, hindsight, loop = re.findall(
        r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    for learner in (sb3.SAC, sb3.TD3):
        monkeypatch.setattr(learner, "learn", lambda self, steps: self)  # noqa: ARG005
    (tmp_path / "page_for_test.py").write_text(own)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(training, {})
        exec(hindsight, {})
    (tmp_path / "wrapped_for_test.py").write_text(wrapped)
    few = ["--episodes", "1", "--space", "anchor", "--backend", "mujoco"]
    assert cli.main(["transfer", "jacobian", "page_for_test:Pull", "mine.zip", *few]) == 0
    assert cli.main(["evaluate", "wrapped_for_test:policy", *few]) == 0
    shown = capsys.readouterr().out
    for name in ("jacobian", "Pull", "mine"):
        assert f"| {name} " in shown
    assert StableBaselines("hindsight.zip").name == "hindsight"
    assert least_distance(loop) < 0.03


def least_distance(loop: str) -> float:
    """Run the page's own loop on a simulation, and return how near its target the tip comes."""
    simulation, target = make_simulation(load_robot("paper"), "mujoco"), np.array([0.2, 0.1, 2.4])
    found: list[float] = []

    def measure() -> tuple[np.ndarray, ...]:
        state = simulation.state()
        parts = [part[0] for part in parts_of(state, target[None], np.zeros(1)).values()]
        return parts[0], parts[1], np.concatenate(parts[4:8]), parts[8]

    def send(command: np.ndarray) -> None:
        simulation.step(command[None])
        found.append(float(np.linalg.norm(simulation.state().tip_position[0] - target)))

    exec(loop, {"measure": measure, "send": send})
    simulation.close()
    return min(found)
