"""A matrix and a sweep pass their options to each evaluation, and that to the engine."""

from __future__ import annotations

import inspect
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.tasks.catalogue import TASKS
from controllers.jacobian import JacobianController
from tests.support.controllers import Still
from tests.support.tiny import Options
from training.measure import evaluation
from training.measure import plant_sweep as sweeps
from training.measure import transfer_matrix as transfer
from training.measure.evaluation import Result, evaluate
from training.measure.plant_axes import AXES, ActualPlant
from training.measure.plant_sweep import Point, halvings, sweep
from training.measure.sweep_table import between_plants, differences, format_sweep
from training.policy import Policy

Array = NDArray[np.float64]


def result(successes: int, total: int = 4, length: int = 100) -> Result:
    done = np.arange(total) < successes
    return Result(
        done, np.where(done, length, 500), np.where(done, 0.02, 0.5), np.zeros((total, 3))
    )


def spy(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, successes: dict[float, int]
) -> list[Options]:
    """Note the arguments of `evaluate`; the mass of the links gives how many episodes succeed."""
    asked: list[Options] = []

    def measured(*arguments: object, **options: object) -> Result:
        bound = inspect.signature(evaluate).bind(*arguments, **options)
        bound.apply_defaults()
        asked.append(bound.arguments)
        plant = bound.arguments["plant"]
        level = (
            1.0 if plant is None or plant.parameters is None else float(plant.parameters.link_mass)
        )
        return result(successes[level])

    monkeypatch.setattr(module, "evaluate", measured)
    return asked


def test_each_controller_of_a_matrix_acts_as_it_is_meant_to(
    policy: Policy, paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, noise = spy(monkeypatch, transfer, {1.0: 2}), Disturbances(action_noise=0.5)
    controllers = [JacobianController(paper), policy]
    cells = transfer.transfer(
        controllers, paper, ["mujoco", "pybullet"], ["anchor", "spatter"], 4, 7, noise, "quiet"
    )
    assert [(one["controller"].name, one["space"], one["backend"]) for one in asked] == [
        (cell.controller, cell.space, cell.backend) for cell in cells
    ]
    assert len(asked) == 8
    for one in asked:
        assert (one["episodes"], one["seed"], one["disturbances"], one["task"]) == (
            4,
            7,
            noise,
            "quiet",
        )
        assert one["controller"] in controllers
        assert (one["centers"], one["frame_skip"]) == (None, None)  # the controller's own
    assert {(c.controller, c.trained_in, c.trained_on) for c in cells} == {
        ("jacobian", "-", "-"),
        ("p", "pybullet", "floating"),
    }
    assert cells[0].as_dict()["failed"] == [2, 3]


def test_failed_episodes_are_named() -> None:
    assert result(1).summary()["failed"] == [1, 2, 3]


@pytest.mark.parametrize(
    ("task", "steps"), [("reach", 250), ("capture", 500), ("follow-line", 1000)]
)
def test_a_failure_counts_in_full_for_its_task(task: str, steps: int, small_robot: Robot) -> None:
    """50 steps an action, and on a plant of half the time step 100 of its own."""
    for plant in (None, AXES["time_step"].plant(small_robot, 0.5)):
        found = evaluate(
            Still(), small_robot, "mujoco", "anchor", 2, frame_skip=50, task=task, plant=plant
        )
        assert not found.success.any()
        assert found.length.tolist() == [steps] * 2


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Options]:
    """Collects the options with which environments are made."""
    options_made: list[Options] = []

    class Noted(TaskVectorEnv):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            options_made.append(options)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(evaluation, "TaskVectorEnv", Noted)
    return options_made


def test_centers_and_frame_skip_are_the_controllers_unless_given(
    made: list[Options], policy: Policy, paper: Robot
) -> None:
    evaluate(policy, paper, "mujoco", "floating", 1)
    evaluate(JacobianController(paper), paper, "mujoco", "floating", 1)
    evaluate(policy, paper, "mujoco", "floating", 1, centers=np.ones((1, 3)), frame_skip=50)
    assert made[0]["centers"] is policy.centers
    assert made[1]["centers"] is None
    assert made[2]["centers"].tolist() == [[1, 1, 1]]
    assert [options["frame_skip"] for options in made] == [5, 1, 50]


def test_a_plant_adds_its_delay_to_the_disturbances(
    made: list[Options], small_robot: Robot
) -> None:
    noise = Disturbances(action_noise=0.1, observation_delay=1)
    for plant in (None, ActualPlant(small_robot, observation_delay=4)):
        options = {"disturbances": noise, "plant": plant}
        evaluate(Still(), small_robot, "mujoco", "anchor", 1, frame_skip=50, **options)
    late = Disturbances(action_noise=0.1, observation_delay=4)
    assert [options["disturbances"] for options in made] == [noise, late]


def test_a_sweep_ends_with_the_level_of_exactly_half_and_asks_for_the_policy_as_it_acts(
    policy: Policy, paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = spy(monkeypatch, sweeps, {1: 4, 2: 2, 0.5: 3, 0.25: 3})
    points = sweep(policy, paper, "mujoco", "floating", AXES["link_mass"], [2, 4, 0.5, 0.25], 4, 7)
    assert [point.level for point in points] == [1, 2, 0.5, 0.25]
    up, down = halvings(points)
    assert (up.level, down.level) == (2, None)
    assert (up.text, down.text) == ("2", "beyond 0.25 (0.75)")
    for one in asked:
        assert (one["centers"], one["frame_skip"], one["seed"]) == (None, None, 7)


def test_what_a_changed_plant_loses_is_against_the_same_engine() -> None:
    axis = AXES["link_mass"]
    points = [
        Point(backend, "anchor", axis, level, result(successes))
        for backend, counts in (("mujoco", (4, 3, 4)), ("pybullet", (2, 2, 3)))
        for level, successes in zip((1.0, 2.0, 0.5), counts, strict=True)
    ]
    found = [
        (d.episode, d.better.backend, d.better.level, d.worse.level) for d in between_plants(points)
    ]
    assert found == [(3, "mujoco", 1.0, 2.0), (2, "pybullet", 0.5, 1.0)]


def test_a_table_of_both_directions_compares_each_at_its_outermost_shared_level() -> None:
    axis = AXES["link_mass"]
    points = [
        Point(backend, "anchor", axis, level, result(successes, 10))
        for backend, counts in (("mujoco", (10, 9, 8, 7, 4)), ("pybullet", (10, 8, 6, 3, None)))
        for level, successes in zip((1.0, 2.0, 3.0, 0.5, 0.25), counts, strict=True)
        if successes is not None
    ]
    up, down = (
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in format_sweep(points).splitlines()[2:]
    )
    assert up[2:] == [
        "up",
        "beyond 3 (0.80)",
        "beyond 3 (0.60)",
        "3",
        "+0.20 / +0.40",
        "+0.20 (2 / 0)",
    ]
    # From 0.7 to 0.4 half is two thirds of the way, from 1 to 0.3 five sevenths; by ratio.
    halves = [f"{0.5 * 0.5 ** (2 / 3):.3g}", f"{0.5 ** (5 / 7):.3g}"]
    assert down[2:] == ["down", *halves, "0.5", "+0.30 / +0.70", "+0.40 (4 / 0)"]


def test_late_is_by_the_time_of_the_task() -> None:
    axis, far = AXES["link_mass"], result(0)
    for task, length, expected in (
        ("reach", 226, "late"),
        ("reach", 225, "another path"),
        ("capture", 451, "late"),
        ("capture", 400, "another path"),
    ):
        good = Point("mujoco", "anchor", axis, 1.0, result(1, length=length), task=TASKS[task])
        bad = Point("mujoco", "anchor", axis, 2.0, far, task=TASKS[task])
        assert differences(good, bad)[0].reading.startswith(expected)
