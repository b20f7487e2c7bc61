"""Anything that does not fit into memory is refused before it is made, with figures."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr import memory
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.memory import available_memory, check_memory
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import make_simulation, principal_engines
from controllers.jacobian import JacobianController
from controllers.rollout import rollout
from training.run.setup import Setup
from training.run.train_options import Train


def test_available_memory_is_the_least_that_the_system_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "_GROUP", tmp_path)
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "meminfo")
    everything = available_memory()
    (tmp_path / "meminfo").write_text("MemTotal: 9000 kB\nMemAvailable:    5000 kB\n")
    assert available_memory() == 5_120_000.0 < everything
    (tmp_path / "memory.max").write_text("max\n")
    assert available_memory() == 5_120_000.0
    (tmp_path / "memory.max").write_text("3000000\n")
    (tmp_path / "memory.current").write_text("2500000\n")
    (tmp_path / "memory.stat").write_text("file 900000\ninactive_file 500000\n")
    assert available_memory() == 1_000_000.0
    (tmp_path / "memory.current").write_text("9000000\n")
    assert available_memory() == 0.0


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a machine with 0.2 GB free."""
    monkeypatch.setattr(memory, "available_memory", lambda: 2e8)


@pytest.mark.usefixtures("full")
def test_figures_and_the_remedy_are_said() -> None:
    check_memory("Something", 1.9e8, "do less")
    with pytest.raises(CdcsrError) as caught:
        check_memory("Something", 2.5e9, "do less")
    assert str(caught.value) == (
        "Something would need about 2.5 GB of memory, and 0.2 GB are free; do less."
    )


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("engine", principal_engines())
def test_too_many_copies_are_refused(engine: str) -> None:
    with pytest.raises(CdcsrError, match=f"5000 copies in {engine} would need about .* GB"):
        make_simulation(load_robot("paper"), engine, 5_000)


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"capacity": 100_000_000}, r"A replay with a capacity of 100,000,000 rows would need"),
        (
            {"hidden": (8_000, 8_000)},
            r"networks of hidden layers \(8000, 8000\)",
        ),
        ({"batch_size": 100_000}, r"batches of 100,000 would need"),
    ],
)
def test_a_learner_that_does_not_fit_is_refused(
    numbers: dict[str, object], message: str, tmp_path: Path
) -> None:
    changes = {"capacity": 100_000, **numbers}
    with pytest.raises(CdcsrError, match=message):
        Setup(Train(out=tmp_path, algorithm="td3", changes=tuple(changes.items())))


def test_the_records_of_many_episodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    env = TaskVectorEnv(1_000, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    monkeypatch.setattr(memory, "available_memory", lambda: 1.01e8)
    with pytest.raises(CdcsrError, match="The records of 1000 episodes of 250 actions"):
        rollout(JacobianController(env.robot), env, observation)
    env.close()
