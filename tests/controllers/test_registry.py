"""Controllers that a user brings: how they are found, and what is refused."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cdcsr import cli
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from controllers.jacobian import JacobianController
from controllers.registry import SCRIPTED, load_controller, scripted_controller
from controllers.rollout import rollout
from training.measure.evaluation import evaluate

ROBOT = load_robot("planar-single")
MODULE = """
import numpy as np
from controllers.jacobian import JacobianController as Scripted
from controllers.controller import Controller

class Plain:
    def act(self, state, target, time):
        return np.zeros_like(state.cable_travel)

class ForRobot(Plain):
    name = "for a robot"
    privileged, frame_skip, task = True, 5, "capture"
    def __init__(self, robot):
        self.robot = robot

def factory():
    return Plain()

instance, number, unfit = Plain(), 3, Controller

class Fails(Plain):
    def act(self, state, target, time):
        return 1 / 0

class Flat(Plain):
    def act(self, state, target, time):
        return np.zeros(len(time))

class Words(Plain):
    def act(self, state, target, time):
        return "pull"

class Infinite(Plain):
    def act(self, state, target, time):
        return np.full_like(state.cable_travel, np.inf)

class NanOnceOver(Plain):
    def act(self, state, target, time):
        return np.where(np.isnan(time)[:, None], np.nan, -0.001) + 0 * state.cable_travel

class Raises(Plain):
    def __init__(self):
        raise RuntimeError("no\\nluck")

class TwoArguments(Plain):
    def __init__(self, robot, more): ...

class NoTime:
    def act(self, state, target): ...
"""


@pytest.fixture(autouse=True)
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "mine_for_test.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield
    sys.modules.pop("mine_for_test", None)


@pytest.mark.parametrize("name", ["Plain", "factory", "instance", "ForRobot", "Scripted"])
def test_instances_classes_and_factories_are_controllers(name: str) -> None:
    controller = scripted_controller(f"mine_for_test:{name}", ROBOT)
    assert controller is not None
    other = name in ("ForRobot", "Scripted")
    assert controller.privileged == other
    names = {"ForRobot": "for a robot", "Scripted": "jacobian"}
    assert controller.name == names.get(name, name)
    expected = {"ForRobot": (5, "capture"), "Scripted": (1, "reach")}
    assert (controller.frame_skip, controller.task) == expected.get(name, (None, "reach"))


def test_a_loaded_controller_acts_like_the_same_one_by_name() -> None:
    loaded = load_controller("controllers.jacobian:JacobianController", ROBOT)
    results = [
        evaluate(one, ROBOT, "mujoco", "anchor", 3) for one in (loaded, JacobianController(ROBOT))
    ]
    np.testing.assert_array_equal(results[0].distance, results[1].distance)
    assert results[0].success.all()


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("mine_for_test:", "Write a controller as package.module:Object"),
        (":Plain", "Write a controller as package.module:Object"),
        ("no_module_of_mine:Plain", "Importing no_module_of_mine failed: ModuleNotFoundError"),
        ("mine_for_test:Plian", "Did you mean 'Plain'?"),
        ("mine_for_test:number", "is no controller: int has no method act"),
        ("mine_for_test:NoTime", "is no controller: NoTime has no method act(state, target, time)"),
        ("mine_for_test:TwoArguments", "from no argument or from the robot"),
        ("mine_for_test:Raises", "Making mine_for_test:Raises failed: RuntimeError: no ("),
        ("mine_for_test:unfit", "failed: TypeError"),
    ],
)
def test_what_is_no_controller_is_refused_in_one_line(path: str, message: str) -> None:
    with pytest.raises(CdcsrError) as caught:
        scripted_controller(path, ROBOT)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Fails", "Fails.act failed: ZeroDivisionError: division by zero ("),
        ("Flat", "shape (2,); it must be (num, cables) = (2, 4)"),
        ("Words", "returned str, not an array of commands"),
        ("Infinite", "a command that is not finite, 0 s after the start"),
    ],
)
def test_a_mistake_in_acting_is_one_line(name: str, message: str) -> None:
    controller = load_controller(f"mine_for_test:{name}", ROBOT)
    with pytest.raises(CdcsrError) as caught:
        evaluate(controller, ROBOT, "mujoco", "anchor", 2)
    assert message in str(caught.value)


def test_commands_after_an_episode_are_ignored() -> None:
    """The straight arm is at the first target already, and never gets to the second."""
    controller = load_controller("mine_for_test:NanOnceOver", ROBOT)
    env = TaskVectorEnv(2, ROBOT, frame_skip=50, autoreset_mode="Disabled")
    tip = [0.0, 0.0, ROBOT.top + ROBOT.arm_length]
    observation, _ = env.reset(options={"targets": np.array([tip, [0.0, 0.0, 9.0]])})
    done = rollout(controller, env, observation)
    env.close()
    assert done.length.tolist() == [1, 5]
    assert (done.actions[0, 1:] == 0).all()


@pytest.mark.parametrize("command", ["evaluate", "transfer", "sweep", "search"])
def test_every_command_takes_a_controller_from_a_module(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = {"search": ["--out", str(tmp_path / "out")], "sweep": ["--axis", "link_mass"]}
    asked = [command, "mine_for_test:Fails", "--episodes", "1", *more.get(command, [])]
    assert cli.main(asked) == 2
    assert "Fails.act failed: ZeroDivisionError" in capsys.readouterr().err


def test_names_that_stand_for_no_scripted_controller_are_left_to_others() -> None:
    assert scripted_controller("batd3-spatter-mujoco", ROBOT) is None
    assert {make(ROBOT).name for make in SCRIPTED.values()} == set(SCRIPTED)
