"""Second plants: that each axis acts as its name says, that policies meet them only by intent, and the sweep's sums."""

from __future__ import annotations

import csv
import json
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from backends.pybullet.simulation import PybulletSimulation
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Simulation, State
from cdcsr.simulation.engines import backend_names, make_simulation
from cdcsr.simulation.plant import Parameters
from controllers.controller import Conditions, Controller, Target
from training.commands.sweep import sweep as command
from training.config.run_description import SCRIPTED, RunDescription
from training.config.seeds import VALIDATION_SEED
from training.measure import plant_sweep as sweeps
from training.measure.evaluation import Result, evaluate
from training.measure.plant_axes import AXES, Axis, find_axes
from training.measure.plant_sweep import Point, directions, halvings, sweep
from training.measure.sweep_table import between_engines, differences, format_sweep
from training.policy import Policy, find_policy
from training.study.execute import evaluations

both = pytest.mark.parametrize("backend", backend_names())


@pytest.fixture(scope="module")
def paper() -> Robot:
    return load_robot("paper")


@pytest.fixture(scope="module")
def policy() -> Policy:
    return find_policy("batd3-spatter-mujoco")


# --- What the axes do ----------------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize(
    ("name", "level"), [("servo_gain", 0.1), ("slider_damping", 10.0), ("servo_gain", 1.0)]
)
def test_one_step_of_a_free_slider(backend: str, name: str, level: float, paper: Robot) -> None:
    """Let out, a cable is slack, and its slider alone: m v / h = k u - c v. The base is 2500 times as heavy."""
    plant, servo, step, out = AXES[name].plant(paper, level), paper.servos[0], paper.time_step, 0.1
    gain, damping = servo.gain, servo.damping
    if name == "servo_gain":
        gain *= level
    else:
        damping *= level
    simulation = make_simulation(plant.robot, backend)
    if plant.parameters is not None:
        simulation.set_parameters(None, plant.parameters)
    simulation.reset()
    simulation.step(np.array([[out] + [0.0] * 7]))
    velocity = simulation.get_snapshot().velocity[0, 6]
    simulation.close()
    assert velocity == pytest.approx(step * gain * out / (servo.mass + step * damping), rel=1e-3)


class Clock(Controller):
    """Pulls nothing and notes the time."""

    name = "clock"

    def __init__(self) -> None:
        self.times: list[float] = []
        self.time_step = 0.0

    privileged = True

    def begin(self, conditions: Conditions) -> None:
        self.time_step = conditions.robot.time_step

    def act(self, state: State, target: Target, time: NDArray[Any]) -> NDArray[Any]:
        self.times.append(float(state.time[0]))
        return np.zeros_like(state.cable_travel)


def test_the_time_step_axis_keeps_the_control_period(paper: Robot) -> None:
    clock = Clock()
    result = evaluate(
        clock,
        paper,
        "mujoco",
        "anchor",
        1,
        VALIDATION_SEED,
        plant=AXES["time_step"].plant(paper, 0.25),
    )
    assert clock.time_step == paper.time_step / 4
    np.testing.assert_allclose(clock.times, np.arange(250) * paper.time_step, atol=1e-9)
    assert result.length.tolist() == [250]


def test_the_softness_axis_scales_time_and_compliance(paper: Robot) -> None:
    soft = AXES["cable_softness"].plant(paper, 8.0).robot
    assert soft.constraint.recovery_time == pytest.approx(8 * paper.constraint.recovery_time)
    d, other = paper.mujoco.impedance, soft.mujoco.impedance
    assert (1 - other) / other == pytest.approx(8 * (1 - d) / d)
    assert soft.model_copy(update={"constraint": paper.constraint, "mujoco": paper.mujoco}) == paper


def test_mujocos_own_settings_stretch_a_cable(paper: Robot) -> None:
    simulation, excess = make_simulation(paper, "mujoco"), []
    rest = simulation.dynamics().cable_length[0, 0]
    for _ in range(2):
        for _ in range(60):
            simulation.step(np.array([[-5.0] + [0.0] * 7]))
        excess.append(simulation.dynamics().cable_length[0, 0] - rest)
        simulation.use_own_settings()
    simulation.close()
    assert abs(excess[0]) < 1e-4
    assert excess[1] > 1e-3


@pytest.mark.parametrize("workers", [0, 2])
def test_pybullets_own_settings_damp_a_drift(workers: int, paper: Robot) -> None:
    """Bullet's law for multibodies is v' = -k (1 + |v|) v, on every body alike: a drift stays a drift."""
    simulation, after = PybulletSimulation(paper, 2, workers), []
    for _ in range(2):
        snapshot = simulation.get_snapshot()
        snapshot.velocity[:, 2] = 0.1
        simulation.set_snapshot(snapshot)
        simulation.step(np.zeros((2, 8)), substeps=100)
        after.append(simulation.state().tip_velocity[:, 2])
        simulation.use_own_settings()
    assert (simulation.state().time == 0).all()
    simulation.close()
    expected = 0.1
    for _ in range(100):
        expected -= paper.time_step * 0.04 * (1 + expected) * expected
    np.testing.assert_allclose(after[0], 0.1, rtol=1e-9)
    np.testing.assert_allclose(after[1], expected, rtol=1e-4)


@both
def test_own_settings_leave_parameters_in_force(backend: str, paper: Robot) -> None:
    simulation = make_simulation(paper, backend)
    simulation.set_parameters(None, Parameters(base_mass=2.0))
    simulation.use_own_settings()
    mass = simulation.dynamics().mass_matrix[0, 0, 0]
    simulation.close()
    assert mass == pytest.approx(paper.total_mass + paper.base.mass)


def test_an_engine_without_settings_of_its_own_says_so(paper: Robot) -> None:
    with pytest.raises(CdcsrError, match="'mujoco' declares no settings of its own"):
        Simulation.use_own_settings(make_simulation(paper, "mujoco"))


@pytest.mark.parametrize("name", ["servo_gain", "command_delay", "observation_delay"])
def test_a_policy_fails_on_a_plant_that_is_far_off(name: str, policy: Policy, paper: Robot) -> None:
    level = {"servo_gain": 0.1, "command_delay": 100.0, "observation_delay": 100.0}[name]
    rates = [
        evaluate(
            policy, paper, "mujoco", "spatter", 4, VALIDATION_SEED, policy.centers, plant=plant
        ).rate
        for plant in (None, AXES[name].plant(paper, level))
    ]
    assert rates[0] == 1
    assert rates[1] < 0.5


@pytest.mark.parametrize("axis", AXES.values(), ids=list(AXES))
def test_every_level_makes_a_plant(axis: Axis, paper: Robot) -> None:
    assert axis.levels[0] == axis.nominal
    assert list(axis.up) == sorted(axis.up)
    assert list(axis.down) == sorted(axis.down, reverse=True)
    for level in axis.levels:
        plant = axis.plant(paper, level)
        if plant.parameters is not None:
            plant.parameters.plant(paper, 1)
            plant.parameters.delay(1)
        assert (plant.robot is paper) == (
            level == axis.nominal or axis.name not in ("cable_softness", "time_step")
        )


@pytest.mark.parametrize(
    ("name", "level", "message"),
    [
        ("time_step", 2.0, "must be 1 over a whole number"),
        ("time_step", 0.3, "must be 1 over a whole number"),
        ("command_delay", 1.5, "must be a whole number of steps, not 1.5"),
        ("engine_defaults", 0.5, "is 0 .* or 1"),
    ],
)
def test_levels_that_are_none_are_refused(
    name: str, level: float, message: str, paper: Robot
) -> None:
    with pytest.raises(CdcsrError, match=message):
        AXES[name].plant(paper, level)


def test_an_unknown_axis_is_told() -> None:
    with pytest.raises(CdcsrError, match=r"Unknown axis 'link_mas'. Did you mean 'link_mass'\?"):
        find_axes(("link_mas",))
    with pytest.raises(CdcsrError, match="No axis is given"):
        find_axes(())
    assert [axis.name for axis in find_axes(("servo_gain", "link_mass"))] == [
        "link_mass",
        "servo_gain",
    ]
    assert find_axes(("all",)) == list(AXES.values())


# --- By intent only ------------------------------------------------------------------------------------------------


def test_a_policy_acts_on_a_changed_robot_only_if_told_to(policy: Policy, paper: Robot) -> None:
    softer, softest = (AXES["cable_softness"].plant(paper, level) for level in (2.0, 4.0))
    arguments = ("mujoco", "spatter", 1, VALIDATION_SEED)
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy, softer.robot, *arguments)
    evaluate(policy, paper, *arguments, plant=softer)
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy, softer.robot, *arguments)  # told once is not told for ever
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy.on(softer.robot), softest.robot, *arguments)
    with pytest.raises(CdcsrError, match="it is for other links or cables"):
        policy.on(load_robot("planar-single"))


# --- The sweep's sums ----------------------------------------------------------------------------------------------


def _result(success: list[bool], distance: float = 0.5, length: int = 100) -> Result:
    done = np.array(success)
    n = len(done)
    return Result(
        done,
        np.where(done, length, 250),
        np.where(done, 0.02, distance),
        np.arange(3.0 * n).reshape(n, 3),
    )


def _scripted(monkeypatch: pytest.MonkeyPatch, rates: dict[float, float | None]) -> list[float]:
    """Makes every evaluation succeed in the first episodes of ten, as many as `rates` say; None diverges."""
    asked: list[float] = []

    def measured(*arguments: Any, plant: Any, **options: Any) -> Result:  # noqa: ARG001
        level = 1.0 if plant.parameters is None else float(plant.parameters.link_mass)
        asked.append(level)
        rate = rates[level]
        if rate is None:
            raise Diverged("mujoco", 3, 0.1, "a speed of 1e9")
        return _result([i < 10 * rate for i in range(10)])

    monkeypatch.setattr(sweeps, "evaluate", measured)
    return asked


def test_a_sweep_goes_outwards_until_success_halves(
    monkeypatch: pytest.MonkeyPatch, paper: Robot
) -> None:
    asked = _scripted(monkeypatch, {1: 1.0, 2: 0.8, 4: 0.4, 0.5: 0.9, 0.25: None})
    points = sweep(
        Clock(), paper, "mujoco", "anchor", AXES["link_mass"], [8, 0.25, 2, 0.125, 4, 0.5], 10
    )
    assert asked == [1, 2, 4, 0.5, 0.25]
    up, down = halvings(points)
    # A half lies three quarters of the way from 0.8 to 0.4; in ratio, 2 * 2 ** 0.75.
    assert up.level == pytest.approx(2 * 2**0.75)
    assert (down.level, down.text) == (None, "diverges at 0.25")
    assert [row.level for row in points[1].rows] == [2.0] * 10
    assert points[-1].rows == []
    assert points[-1].as_dict()["diverged"].startswith("mujoco: copy 3 diverged")


def test_offsets_are_interpolated_by_difference() -> None:
    assert AXES["command_delay"].between(2, 4, 0.5) == 3
    assert AXES["link_mass"].between(1, 4, 0.5) == pytest.approx(sqrt(4))
    assert directions(AXES["rest_length_offset"], [0.1, -0.2, 0, -0.1]) == [[0.1], [-0.1, -0.2]]


def test_nothing_to_lose_is_an_error(monkeypatch: pytest.MonkeyPatch, paper: Robot) -> None:
    _scripted(monkeypatch, {1: 0.0})
    with pytest.raises(CdcsrError, match=r"'clock' has no success in mujoco \(precise, anchor\)"):
        sweep(Clock(), paper, "mujoco", "anchor", AXES["link_mass"], task="precise")


def test_every_point_is_of_the_task(monkeypatch: pytest.MonkeyPatch, paper: Robot) -> None:
    tasks: list[str] = []

    def measured(*_: Any, task: str = "reach", **__: Any) -> Result:
        tasks.append(task)
        return _result([True])

    for module in (sweeps, evaluations):
        monkeypatch.setattr(module, "evaluate", measured)
    subject = evaluations.Subject(
        RunDescription(algorithm=SCRIPTED, task="capture", updates=0), Clock(), paper
    )
    assert len(list(evaluations.plants(subject, 1))) > 2 * len(AXES)
    assert set(tasks) == {"capture"}


def test_differences_name_the_episode_and_a_reading() -> None:
    axis = AXES["link_mass"]
    first = Point("mujoco", "anchor", axis, 2.0, _result([True, True, False], 0.05))
    second = Point("pybullet", "anchor", axis, 2.0, _result([False, True, True], 0.2, 240))
    found = [d.as_dict() for d in differences(first, second)]
    assert [(d["episode"], d["succeeds"]["backend"]) for d in found] == [
        (0, "mujoco"),
        (2, "pybullet"),
    ]
    assert found[0]["reading"] == "another path: ends 200 mm from the target"
    assert found[1]["reading"].startswith("near miss: ends 50 mm")
    assert found[0]["target"] == [0, 1, 2]
    assert len(between_engines([first, second])) == 2
    captured, missed = (
        Point("mujoco", "anchor", axis, 2.0, _result([True], length=240), task="capture"),
        [],
    )
    for distance in (0.02, 0.2):
        other = Point("pybullet", "anchor", axis, 2.0, _result([False], distance), task="capture")
        missed.append(differences(captured, other)[0].as_dict()["reading"])
    # Near is not enough to capture, and 240 of 500 steps are not late.
    assert missed[0] == "at the target, but not as capture asks: ends 20 mm from it"
    assert missed[1] == "another path: ends 200 mm from the target"


def test_the_table_tells_the_engines_gap_from_the_parameters() -> None:
    axis = AXES["command_delay"]
    points = [
        Point(backend, "anchor", axis, level, _result([i < successes for i in range(10)]))
        for backend, counts in (("mujoco", (10, 8, 4)), ("pybullet", (10, 6, 3)))
        for level, successes in zip((0.0, 1.0, 2.0), counts, strict=True)
    ]
    row = " ".join(format_sweep(points).splitlines()[2].split())
    assert row == "| command_delay | steps | up | 1.75 | 1.33 | 2 | +0.60 / +0.70 | +0.10 (1 / 0) |"


def test_the_command_writes_every_episode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, data = tmp_path / "plants.csv", tmp_path / "plants.json"
    command(
        "jacobian",
        backend="mujoco",
        axis=("engine_defaults",),
        episodes=2,
        seed=1,
        csv=table,
        json=data,
    )
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "backend",
        "space",
        "axis",
        "level",
        "episode",
        "success",
        "length",
        "distance",
    ]
    assert [(row["level"], row["episode"]) for row in rows] == [
        ("0.0", "0"),
        ("0.0", "1"),
        ("1.0", "0"),
        ("1.0", "1"),
    ]
    assert [point["level"] for point in json.loads(data.read_text("utf-8"))["points"]] == [0.0, 1.0]
    assert "| engine_defaults | switch | up |" in capsys.readouterr().out
