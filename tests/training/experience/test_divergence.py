"""A copy that diverges ends neither a run nor a measurement: its episode is dropped and counted."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from backends.mujoco.simulation import MujocoSimulation
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot
from controllers import demonstrations
from controllers.jacobian import JacobianController
from tests.support.tiny import FRAME_SKIP, tiny_changes
from training.experience.collector import Collector
from training.measure.evaluation import evaluate
from training.networks.actor import Actor
from training.run.metrics import read_metrics
from training.run.train_options import Train
from training.run.trainer import train

Array = NDArray[np.float64]


@pytest.fixture
def losing(monkeypatch: pytest.MonkeyPatch) -> set[tuple[int, int]]:
    """Make MuJoCo lose copies 1 and 2 in the steps of this set: (number of copies, which step)."""
    step, calls, lost = MujocoSimulation._step, Counter[int](), set[tuple[int, int]]()

    def lossy(self: MujocoSimulation, command: Array, substeps: int) -> None:
        step(self, command, substeps)
        calls[self.num] += 1
        if (self.num, calls[self.num]) in lost:
            copies = [copy for copy in (1, 2) if copy < self.num] or [0]
            self._qvel[copies] = np.nan
            raise Diverged("mujoco", copies[0], 0.1, "a test", copies)

    monkeypatch.setattr(MujocoSimulation, "_step", lossy)
    return lost


def test_the_copy_starts_anew_and_the_others_go_on(
    paper: Robot, losing: set[tuple[int, int]]
) -> None:
    losing.add((4, 3))
    env, calm = TaskVectorEnv(4, paper), TaskVectorEnv(4, paper)
    env.reset(seed=0)
    action = np.full((4, paper.num_cables), -0.01)
    for _ in range(2):
        env.step(action)
    observation, reward, terminated, truncated, info = env.step(action)
    assert info["diverged"].tolist() == truncated.tolist() == [False, True, True, False]
    assert not terminated.any()
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()
    assert env.actions_taken.tolist() == [3, 0, 0, 3]
    assert env.simulation.state().time.tolist() == pytest.approx([0.0075, 0, 0, 0.0075])
    losing.clear()
    calm.reset(seed=0)
    expected = [calm.step(action)[0] for _ in range(3)][-1]
    np.testing.assert_array_equal(observation[[0, 3]], expected[[0, 3]])
    assert "diverged" not in env.step(action)[-1]


def test_one_robot_alone_says_that_it_diverged(losing: set[tuple[int, int]]) -> None:
    losing.add((1, 1))
    env = TaskEnv()
    env.reset(seed=0)
    with pytest.raises(Diverged, match="copy 0 diverged"):
        env.step(np.zeros(env.action_space.shape or ()))
    env.step(np.zeros(env.action_space.shape or ()))  # it is back at the start


def test_dropped_episodes_are_counted_and_the_count_is_resumed(
    paper: Robot, losing: set[tuple[int, int]]
) -> None:
    actor = Actor(paper, True, (4,), "relu")

    def collector() -> Collector:
        env = TaskVectorEnv(3, paper, frame_skip=25, task="reach", max_steps=250)
        made = Collector(env, 0.1, 1, np.random.default_rng(0))
        made.start(0)
        return made

    torch.manual_seed(0)
    losing.add((3, 4))
    one, lengths = collector(), list[int]()
    for _ in range(9):
        lengths += [len(episode.actions) for episode in one.step(actor)]
    assert (one.diverged, lengths) == (2, [])
    kept = {name: np.array(rows) for name, rows in one.state_arrays().items()}
    other = collector()
    other.load_state_arrays(kept)
    for each in (one, other):
        for _ in range(4):
            lengths += [len(episode.actions) for episode in each.step(actor)]
    assert lengths == [10, 10]  # of copy 0, which did not diverge; the others began at call 4
    assert one.diverged == other.diverged == 2
    del kept["diverged"]
    other.load_state_arrays(kept)  # a run of an older version, which lost no episode
    assert other.diverged == 0


def test_measurements_and_demonstrations_count_what_diverged(
    paper: Robot, losing: set[tuple[int, int]]
) -> None:
    losing.add((4, 2))
    controller = JacobianController(paper)
    result = evaluate(controller, paper, "mujoco", "anchor", 4, frame_skip=10)
    assert result.diverged == result.summary()["diverged"] == 2
    assert not result.success[[1, 2]].any()
    assert np.isfinite(result.distance).all()
    losing.add((5, 1))
    env = TaskVectorEnv(5, paper, frame_skip=10, autoreset_mode="Disabled")
    episodes, failed, diverged = demonstrations.record(controller, env, 1, 0)
    assert (len(episodes), diverged) == (1, 2)
    assert failed >= 2


def test_training_goes_on_and_shows_the_count(
    tmp_path: Path, losing: set[tuple[int, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    losing.update({(4, 5), (4, 40)})
    config = Train(
        out=tmp_path / "run",
        algorithm="td3",
        changes=tiny_changes(),
        frame_skip=FRAME_SKIP,
        num_demonstrations=1,
        evaluate_every=30,
        evaluate_episodes=2,
        updates=60,
    )
    train(config)
    rows = read_metrics(tmp_path / "run" / "metrics.csv")
    assert [row["update"] for row in rows] == [30, 60]
    assert [row["diverged"] for row in rows] == [2, 4]
    assert "diverged 4" in capsys.readouterr().out
