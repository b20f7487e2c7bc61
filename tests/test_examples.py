"""The examples: each is short, runs in a process of its own, and says what it found."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
ELSEWHERE = {"onnx_loop.py", "own_engine.py"}
"""Run by tests/training/commands/test_export.py, which makes the file that it needs, and by
tests/backends/contract/test_engines.py."""
RUNS = {
    "step_a_robot.py": ([], r"mujoco: after 0\.50 s .* tension [\d.]+ N\npybullet: after 0\.50 s"),
    "own_controller.py": ([], r"\| pull .*\n(.*\n)*\| batd3-tuned-spatter-mujoco"),
    "own_targets.py": ([], r"12 of 12 targets on the ring were reached"),
    "train_batd3.py": (["run", "40"], r"jacobian: .*\nbc\S*: .*\nbatd3\S*: \d\.\d\d \["),
    "goals_with_sb3.py": (["1040"], r"hindsight\.zip: 1040 steps"),
}
SLOW = {"goals_with_sb3.py", "own_controller.py", "train_batd3.py"}
NEEDS = {"goals_with_sb3.py": "stable_baselines3"}


def test_every_example_is_run_and_short() -> None:
    files = {path.name: path.read_text("utf-8") for path in EXAMPLES.glob("*.py")}
    assert files.keys() == RUNS.keys() | ELSEWHERE
    long = {name for name, text in files.items() if len(text.splitlines()) >= 60}
    assert long == {"own_engine.py"}  # 100 lines of code, a whole engine


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in RUNS]
)
def test_it_runs_and_says_what_it_found(name: str, tmp_path: Path) -> None:
    needed = NEEDS.get(name)
    if needed and not find_spec(needed):
        pytest.skip(f"needs {needed}")
    arguments, expected = RUNS[name]
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(expected, done.stdout), done.stdout
