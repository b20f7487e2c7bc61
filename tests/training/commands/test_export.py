"""An exported policy acts as the policy does, and needs nothing of this project to run."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from copy import deepcopy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from cdcsr.cli import main
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.state import State
from cdcsr.tasks.observation import PARTS, observe
from controllers.controller import Target
from tests.support.paths import ROOT
from tests.support.tiny import CENTERS
from training.networks.actor import Actor
from training.policy import Policy, find_policy

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")

FOREIGN = ["torch", "mujoco", "pybullet", "gymnasium", "cdcsr", "backends", "controllers"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with exported policies, and a run `plain` for another robot."""
    folder, robot = tmp_path_factory.mktemp("exported"), load_robot("three-cable")
    torch.manual_seed(0)
    card = {"name": "plain", "backend": "mujoco", "space": "anchor", "frame_skip": 4}
    for name, symmetry in (("plain", False), ("mirrored", True)):
        actor = Actor(robot, not symmetry, (16, 16), "tanh", symmetry)
        Policy(actor, robot, CENTERS, card).save(folder / name)
    return folder


def exported(policy: str, folder: Path, dtype: str = "float32") -> Path:
    path = folder / f"{Path(policy).name}-{dtype}.onnx"
    assert path.exists() or not main(["export", policy, "--out", str(path), "--dtype", dtype])
    return path


@cache
def states(name: str) -> tuple[State, NDArray[np.float64]]:
    """Return 10,000 states of 500 copies of a robot that move, and their targets."""
    robot = load_robot(name)
    env = TaskVectorEnv(500, robot, "mujoco", "floating", frame_skip=2)
    env.reset(seed=0)
    rng, low = np.random.default_rng(0), [-servo.eta for servo in robot.servos]
    found, targets = [], []
    for _ in range(20):
        env.step(rng.uniform(low, 0.0, size=(500, len(low))))
        found.append(env.simulation.state())
        targets.append(env.targets)
    env.close()
    names = State.__dataclass_fields__
    rows = {name: np.concatenate([getattr(state, name) for state in found]) for name in names}
    return State(**rows), np.concatenate(targets)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("clasp-anchor-mujoco", "float32"), ("plain", "float64"), ("mirrored", "float32")],
)
def test_onnxruntime_acts_as_the_policy(folder: Path, name: str, dtype: str) -> None:
    path = str(folder / name) if (folder / name).exists() else name
    policy = find_policy(path)
    state, targets = states(policy.robot.name)
    observation = observe(state, targets).astype(dtype)
    assert len(observation) == 10_000
    session = onnxruntime.InferenceSession(exported(path, folder, dtype))
    (command,) = session.run(None, {"observation": observation})
    assert command.dtype == dtype
    with torch.no_grad():
        double = deepcopy(policy.actor).double()
        expected = double.command(torch.as_tensor(observation).double()).numpy()
    np.testing.assert_allclose(command, expected, rtol=0, atol=1e-6)
    # The policy itself computes in float32, whose sums are off by 1e-5 of the range.
    largest = max(servo.eta for servo in policy.robot.servos)
    target = Target(targets, np.zeros_like(targets))
    acted = policy.act(state, target, state.time)
    np.testing.assert_allclose(command, acted, rtol=0, atol=1e-5 * largest)
    assert np.ptp(command, axis=0).min() > 0.01 * largest


def test_the_file_says_how_to_use_it(folder: Path) -> None:
    policy = find_policy(str(folder / "plain"))
    session = onnxruntime.InferenceSession(exported(str(folder / "plain"), folder, "float64"))
    metadata = session.get_modelmeta().custom_metadata_map
    about = {name: json.loads(text) for name, text in metadata.items()}
    robot = policy.robot
    assert about["robot_fingerprint"] == robot.fingerprint
    assert about["control_rate_hz"] == pytest.approx(1 / (4 * robot.time_step))
    assert about["command_low"] == [-servo.eta for servo in robot.servos]
    assert about["command_high"] == [0.0] * robot.num_cables
    state, targets = states(policy.robot.name)
    observation = observe(state, targets)
    for part in about["observation"]:
        if part["name"] not in ("target", "distance"):
            seen = observation[:, part["start"] : part["start"] + part["width"]]
            np.testing.assert_array_equal(seen, getattr(state, part["name"]))
    units = {part["name"]: part["unit"] for part in about["observation"]}
    assert list(units) == [part.name for part in PARTS]
    assert units["base_angular_velocity"] == "rad/s"
    assert b"actor.py" not in exported(str(folder / "plain"), folder, "float64").read_bytes()


def test_the_example_runs_at_400_hz_with_nothing_else_installed(folder: Path) -> None:
    path = exported("clasp-anchor-mujoco", folder)
    hidden = f"import sys, runpy; sys.modules.update(dict.fromkeys({FOREIGN}))"
    script = f"{hidden}; sys.argv[1:] = [{str(path)!r}]; runpy.run_path('examples/onnx_loop.py')"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert not done.stderr
    rate, took = map(float, re.findall(r"(\d+) commands/s; each took ([\d.]+) ms", done.stdout)[0])
    assert 200 < rate < 405  # tests beside this one may take its processor away
    assert took < 2.5


def test_a_file_is_replaced_only_if_asked(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plain.onnx").write_text("mine")
    assert main(["export", str(folder / "plain")]) == 2
    assert "plain.onnx already exists" in capsys.readouterr().err
    assert (tmp_path / "plain.onnx").read_text() == "mine"
    assert main(["export", str(folder / "plain"), "--force"]) == 0
    assert onnxruntime.InferenceSession("plain.onnx").get_inputs()[0].name == "observation"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "onyx"], "Unknown format 'onyx'. Did you mean 'onnx'?"),
        (["--dtype", "float16"], "Unknown type 'float16'"),
    ],
)
def test_wrong_options_are_one_line(
    options: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(folder / "plain"), *options]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
