"""The shipped robots pass all checks of parity, and a wrong number in one engine is found by
name."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from backends.contract_suite.states import KINDS
from backends.mujoco.simulation import MujocoSimulation
from backends.parity import report
from backends.parity.checks import Check, Engines
from backends.parity.one_state import one_state, random_states
from backends.parity.one_step import one_step
from backends.parity.open_loop import OpenLoop, accurate_step, open_loop, refined
from backends.parity.plots import draw
from backends.parity.report import Parity, measure, show
from backends.parity.trajectories import Commands, random_commands
from backends.pybullet.simulation import PybulletSimulation
from cdcsr.cli import run
from cdcsr.files import JsonObject
from cdcsr.robot.description import Robot, load_robot, shipped_robots
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.engines import engine_factory, switched_off
from training.commands.parity import parity as command
from training.measure.trajectories import demonstrator_commands

Change = Callable[[JsonObject], None]
"""Changes the plain data of a description in place."""
ENGINES: Engines = {"mujoco": MujocoSimulation, "pybullet": PybulletSimulation}


def both(robot: Robot, episodes: int, seed: int) -> list[Commands]:
    """Return commands of the demonstrator, and random ones."""
    demonstrated = demonstrator_commands(robot, "mujoco", episodes, seed)
    return [demonstrated, random_commands(robot, episodes, seed)]


@pytest.fixture(scope="module")
def result(paper: Robot) -> Parity:
    """Measure all levels on the paper's robot, with one episode of each kind of commands."""
    return measure(paper, ENGINES, both(paper, 1, 0), seed=0)


def with_wrong_mujoco(change: Change) -> Engines:
    """Return PyBullet, and a MuJoCo whose model is of another robot than it reports."""

    def make(robot: Robot, num: int) -> MujocoSimulation:
        data = robot.model_dump()
        change(data)
        simulation = MujocoSimulation(Robot.model_validate(data), num)
        simulation.robot = robot
        return simulation

    return {"pybullet": PybulletSimulation, "mujoco": make}


def scaled(section: str, key: str, factor: float) -> Change:
    """Return a change that multiplies a number of the first segment."""

    def change(data: JsonObject) -> None:
        data["segments"][0][section][key] *= factor

    return change


# --- level 1 --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KINDS)
def test_the_engines_agree_at_random_states(name: str) -> None:
    checks = one_state(load_robot(name), ENGINES)
    assert [str(check) for check in checks if not check.passed] == []
    names = [
        "mass matrix",
        "generalized tip Jacobian",
        "bias force",
        "passive force",
        "cable length",
        "cable Jacobian",
    ]
    assert [check.name for check in checks if check.pair == "pybullet - mujoco"] == names
    assert sum(check.pair.endswith("closed form") for check in checks) == 2 * 2


def test_random_states_are_turned_and_moving_and_some_cables_are_slack(paper: Robot) -> None:
    states, route = random_states(paper, 32, seed=0), routing(paper)
    np.testing.assert_allclose(np.linalg.norm(states.position[:, 3:7], axis=1), 1)
    assert np.abs(states.position[:, 4:7]).min(axis=0).max() > 0
    assert (np.ptp(states.velocity, axis=0) > 1.2).all()  # in both directions
    travel, hinges = states.position[:, 7:15], states.position[:, 15:]
    assert -1.2 <= hinges.min() < -0.5 < 0.5 < hinges.max() <= 1.2  # of limits of 1.5
    slack = (route.rest_length - cable_lengths(route, travel, hinges)) / route.slider_offset
    assert -0.1 <= slack.min() < -0.09 < 0.09 < slack.max() <= 0.1 + 1e-9


@pytest.mark.parametrize(
    ("section", "key", "factor", "name"),
    [
        ("link", "mass", 1 + 1e-6, "mass matrix"),
        ("joint", "stiffness", 1 + 1e-6, "passive force"),
        ("servo", "damping", 1 + 1e-6, "passive force"),
        ("servo", "mass", 1 + 1e-6, "mass matrix"),
    ],
)
def test_a_wrong_number_in_one_engine_is_caught_by_name(
    paper: Robot, section: str, key: str, factor: float, name: str
) -> None:
    checks = one_state(paper, with_wrong_mujoco(scaled(section, key, factor)), num=4)
    failed = [check for check in checks if not check.passed]
    assert (failed[0].level, failed[0].name, failed[0].pair) == (1, name, "mujoco - pybullet")


def test_the_place_of_a_wrong_number_is_named(paper: Robot) -> None:
    """The guides of the first segment's cables are moved by 2 micrometres."""
    checks = one_state(paper, with_wrong_mujoco(scaled("cables", "guide_offset", 1 + 1e-4)), num=4)
    where = {
        check.name: check.where
        for check in checks
        if check.pair == "mujoco - pybullet" and not check.passed
    }
    assert where["cable length"] in {f"cable_{c}" for c in range(4)}


def test_the_tolerance_of_lengths_grows_with_the_arm() -> None:
    """The arm of 0.12 m is a twentieth of the paper's."""
    checks = one_state(load_robot("bench-arm"), ENGINES, num=2)
    lengths = [check.tolerance for check in checks if check.name == "cable length"]
    assert lengths == pytest.approx([1e-9 / 20] * 3)


# --- level 2 --------------------------------------------------------------------------------------


def test_a_servo_that_pulls_harder_is_caught_in_one_step(paper: Robot) -> None:
    """The equation of motion holds no servo force, so the first level to show it is the one with
    commands."""
    engines = with_wrong_mujoco(scaled("servo", "gain", 1.05))
    assert all(check.passed for check in one_state(paper, engines, num=4))
    (found,) = one_step(paper, engines, random_commands(paper, 2, seed=0, steps=20))
    assert "tension, median" in [check.name for check in found.checks() if not check.passed]


def test_an_engine_differs_from_itself_by_nothing(paper: Robot) -> None:
    engines: Engines = {"one": MujocoSimulation, "other": MujocoSimulation}
    (found,) = one_step(paper, engines, random_commands(paper, 2, seed=0, steps=10))
    assert found.pair == "other - one"
    for difference in found.differences.values():
        np.testing.assert_array_equal(difference, np.zeros(20))


def test_soft_cables_are_reported_and_not_judged(paper: Robot) -> None:
    """Stock tendon limits stretch, so the median tension differs by more than its tolerance."""
    commands = random_commands(paper, 2, seed=0, steps=60)
    engines = {name: engine_factory(name) for name in ("mujoco", "mujoco-stock")}
    (found,) = one_step(paper, engines, commands)
    assert found.checks() == []
    judged = dataclasses.replace(found, soft=False).checks()
    assert "tension, median" in [check.name for check in judged if not check.passed]


def test_states_after_the_end_of_an_episode_are_left_out(paper: Robot) -> None:
    commands = Commands(
        "short", random_commands(paper, 2, seed=0, steps=10).values, np.array([3, 10])
    )
    (found,) = one_step(paper, ENGINES, commands)
    assert {len(difference) for difference in found.differences.values()} == {3 + 10}


# --- level 3 --------------------------------------------------------------------------------------


def test_order_and_limits_of_motions_made_by_hand() -> None:
    """At two instants of one episode the tips are off their limits by 3 mm/ms x h and by
    1 mm/ms x h, and the limits are 2 mm apart."""
    steps = np.array([4e-3, 2e-3, 1e-3])
    tips = {"first": np.zeros((3, 2, 1, 3)), "second": np.zeros((3, 2, 1, 3))}
    tips["first"][..., 0] = 3 * steps[:, None, None]
    tips["second"][..., 0] = 2e-3 - steps[:, None, None]
    names, none = frozenset(tips), np.zeros((2, 1))
    loop = OpenLoop("demonstrator", steps, np.arange(2.0), tips, none, names, {}, arm_length=7.0)
    np.testing.assert_allclose(loop.errors("first"), [12e-3, 6e-3, 3e-3])
    np.testing.assert_allclose(loop.errors("second"), [4e-3, 2e-3, 1e-3])
    assert (loop.order("first"), loop.order("second")) == (pytest.approx(1), pytest.approx(1))
    np.testing.assert_allclose(loop.mean_distance("second"), [14e-3, 6e-3, 2e-3])
    assert loop.limit_distance("second") == pytest.approx(2e-3)
    assert {check.level for check in loop.checks()} == {3}
    found = {check.name: check for check in loop.checks()}
    assert found["mean tip distance"].passed
    assert found["limits apart"].value == pytest.approx(2 / 12)
    assert not found["limits apart"].passed
    alone = dataclasses.replace(loop, ideal=frozenset({"first"}))
    assert {check.name for check in alone.checks()} == {"order"}


def test_a_curve_of_another_order_is_caught() -> None:
    """An engine whose error falls with the root of the step has the order 0.5."""
    steps = np.array([4e-3, 2e-3, 1e-3, 0.5e-3])
    tips = np.zeros((4, 2, 1, 3))
    tips[..., 0] = np.sqrt(steps)[:, None, None]
    none = np.zeros((2, 1))
    loop = OpenLoop("random", steps, np.arange(2.0), {"a": tips}, none, frozenset(), {}, 1.0)
    assert [check.name for check in loop.checks() if not check.passed] == ["order"]


@pytest.mark.parametrize(("episodes", "order"), [(1, 5 / 6), (2, 2 / 3)])
def test_one_sensitive_episode_does_not_decide_the_order(episodes: int, order: float) -> None:
    """Two or four of six instants, in four episodes, have errors that are a thousand times larger
    and of the order 0.5. A mean of lengths would find 0.5 even with two."""
    steps = np.array([4e-3, 2e-3, 1e-3, 0.5e-3])
    tips = np.zeros((4, 2, 4, 3))
    tips[..., 0] = steps[:, None, None]
    tips[..., :episodes, 0] = 1e3 * np.sqrt(steps)[:, None, None]
    tips[:, 1, 3], tips[:, 0, 2] = np.nan, 0  # after its end, and at rest
    none = np.zeros((2, 4))
    loop = OpenLoop("random", steps, np.arange(2.0), {"a": tips}, none, frozenset(), {}, 1.0)
    assert loop.order("a") == pytest.approx(order)


def test_a_refined_robot_keeps_the_recovery_time_in_steps(paper: Robot) -> None:
    fine = refined(paper, 4)
    assert (fine.time_step, fine.constraint.recovery_time) == (
        paper.time_step / 4,
        paper.constraint.recovery_time / 4,
    )
    assert fine.segments == paper.segments


@pytest.mark.parametrize("engine", ENGINES)
def test_two_runs_estimate_the_step_that_four_measure(engine: str) -> None:
    """Under other commands, from the limit of eight times smaller steps."""
    robot = load_robot("planar-single")
    alone = {engine: ENGINES[engine]}
    measured = open_loop(robot, alone, random_commands(robot, 2, seed=7)).accurate_step(
        engine, 1e-3
    )
    estimated = accurate_step(robot, ENGINES[engine], 1e-3)
    assert estimated is not None
    assert 0.6 < estimated / measured < 1.7


def test_an_engine_of_another_robot_converges_elsewhere(paper: Robot) -> None:
    """The damping of the first segment is a tenth less, which a smaller time step does not
    change."""
    engines = with_wrong_mujoco(scaled("joint", "damping", 0.9))
    loop = open_loop(paper, engines, random_commands(paper, 1, seed=0, steps=60))
    assert [check.name for check in loop.checks() if not check.passed] == ["limits apart"]


def test_bullets_damping_is_named_and_accounts_for_the_distance(paper: Robot) -> None:
    """With its damping off, the stock engine is `pybullet`; other switches move nothing."""
    engines = {name: engine_factory(name) for name in ("mujoco", "pybullet-stock")}
    others = {name: engine_factory(name) for name in switched_off("pybullet-stock")}
    commands = random_commands(paper, 2, seed=0, steps=60)
    loop = open_loop(paper, engines, commands, switches={"pybullet-stock": others})
    assert loop.ideal == {"mujoco"}
    assert [check.name for check in loop.checks()] == ["order", "order"]
    damping, *rest = (float(np.nanmax(moved)) for moved in loop.switches.values())
    assert "damping=0" in next(iter(loop.switches))
    assert damping > 1e-5
    assert max(rest) < 1e-9
    assert loop.limit_distance("pybullet-stock") > 0.1 * damping
    assert {moved.shape for moved in loop.switches.values()} == {(60, 2)}


# --- the whole ------------------------------------------------------------------------------------


def test_the_papers_robot_is_within_every_tolerance(result: Parity) -> None:
    assert [str(check) for check in result.failed] == []
    demonstrator = result.open_loop[0]
    assert demonstrator.mean_distance("pybullet")[0] > 1e-4  # two schemes, not one
    assert demonstrator.limit_distance("pybullet") < 1e-5
    tips = demonstrator.tips["mujoco"][0]  # noise of a millionth moves them by about as little
    assert 1e-9 < demonstrator.noise_floor < 1e-5 * np.ptp(tips, axis=0).max()
    for engine in ENGINES:
        assert 0.9 < demonstrator.order(engine) < 1.1


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_robots())
def test_every_shipped_robot_is_within_every_tolerance(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With all engines, by the command as it is."""
    status = run(command, "cdcsr parity", [name])
    assert (status, capsys.readouterr().out.splitlines()[-1].partition("; ")[2]) == (
        0,
        "all within tolerance",
    )


def test_figures_and_json_are_written(result: Parity, tmp_path: Path) -> None:
    data = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert (data["passed"], data["first_failure"], data["reference"]) == (True, None, "mujoco")
    assert {check["level"] for check in data["checks"]} == {1, 2, 3}
    assert all(check["passed"] for check in data["checks"])
    paths = draw(result, tmp_path)
    assert [path.name for path in paths] == [
        "paper-one-step.png",
        "paper-convergence.png",
        "paper-open-loop.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert "all within tolerance" in show(result)


def test_the_command_names_the_first_failure_and_exits_with_1(
    result: Parity,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    broken = Check(
        1, "mass matrix", "pybullet - mujoco", float("nan"), 1e-10, "relative", "hinge_3_x"
    )
    monkeypatch.setattr(
        report, "measure", lambda *_, **__: dataclasses.replace(result, one_state=[broken])
    )
    out = tmp_path / "parity.json"
    assert run(command, "cdcsr parity", ["paper", "--json", str(out)]) == 1
    error = capsys.readouterr().err
    assert "1 parity checks failed, first: level 1, mass matrix, pybullet - mujoco" in error
    assert "worst at hinge_3_x" in error
    data = json.loads(out.read_text())
    assert (data["passed"], data["checks"][0]["passed"], data["checks"][0]["value"]) == (
        False,
        False,
        None,
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--backend", "bullet"], "Unknown backend 'bullet'. Did you mean 'pybullet'?"),
        (["--backend", "mujoco"], "There is no engine to compare 'mujoco' with"),
        (["--episodes", "0"], "episodes must be a whole number from 1 to 1000, not 0."),
    ],
)
def test_wrong_options_exit_with_2(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command, "cdcsr parity", ["paper", *options]) == 2
    assert message in capsys.readouterr().err
