"""The baseline that replays the nearest demonstration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.spaces import demonstration_targets
from controllers.controller import Conditions
from controllers.demonstrations import load
from controllers.nearest import Nearest
from controllers.registry import scripted_controller
from controllers.rollout import Episode, rollout
from training.commands.demonstrate import demonstrate
from training.measure.evaluation import evaluate

Array = NDArray[np.float64]
ROBOT = load_robot("planar-single")


def episode(target: list[float], *commands: float) -> Episode:
    """Make a demonstration whose commands pull all cables alike."""
    actions = np.repeat(np.array(commands)[:, None], ROBOT.num_cables, axis=1)
    nothing = np.zeros(0)
    return Episode(nothing, actions, np.array(target), nothing, True)


def test_the_nearest_demonstration_is_replayed_and_its_last_command_is_held() -> None:
    shown = [episode([0, 0, 1.0], -0.1, -0.2), episode([1.0, 0, 0], -0.3)]
    env = TaskVectorEnv(3, ROBOT, frame_skip=50, autoreset_mode="Disabled")
    controller = Nearest(ROBOT, shown)
    # Each batch has targets of its own; all are out of reach.
    for far, chosen in (([9.0, 0, 9.1], 0), ([9.1, 0, 9.0], 1)):
        targets = np.array([far, [-9.0, 0, 9.0], [9.0, 0, -9.0]])
        observation, _ = env.reset(options={"targets": targets})
        done = rollout(controller, env, observation)
        expected = np.array([[-0.1, -0.2, -0.2, -0.2, -0.2], [-0.3] * 5])[[chosen, 0, 1]]
        assert done.actions[:, :, 0].tolist() == expected.tolist()
    env.close()


@pytest.mark.parametrize("frame_skip", [1, 5])
def test_targets_of_the_ten_recorded_demonstrations_are_reached_again(frame_skip: int) -> None:
    robot = load_robot("paper")
    env = TaskVectorEnv(10, robot, frame_skip=frame_skip, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": demonstration_targets(robot, 10, seed=0)})
    assert rollout(Nearest(robot), env, observation).success.all()
    env.close()


def test_a_dataset_is_replayed_by_name(tmp_path: Path) -> None:
    demonstrate(out=tmp_path / "set", episodes=2, seed=5, robot="planar-single")
    (first, second) = load(tmp_path / "set", ROBOT.fingerprint)
    controller = scripted_controller(f"nearest:{tmp_path / 'set'}", ROBOT)
    assert controller is not None
    env = TaskVectorEnv(2, ROBOT, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"targets": np.array([second.target, first.target])})
    done = rollout(controller, env, observation)
    env.close()
    assert done.length.tolist() == [second.length, first.length]
    np.testing.assert_array_equal(done.actions[0, : second.length], second.actions)
    with pytest.raises(CdcsrError, match="holds no demonstrations"):
        scripted_controller(f"nearest:{tmp_path}", ROBOT)


def test_without_demonstrations_and_engine_there_is_nothing_to_replay() -> None:
    with pytest.raises(CdcsrError, match="nearest:FOLDER"):
        Nearest(ROBOT).begin(Conditions(ROBOT, 0.01, False))


@pytest.mark.slow
@pytest.mark.parametrize(("space", "rate"), [("floating", 1.0), ("anchor", 0.26)])
def test_floating_needs_no_learning(space: str, rate: float) -> None:
    robot = load_robot("paper")
    assert evaluate(Nearest(robot), robot, "mujoco", space).rate == pytest.approx(rate)
