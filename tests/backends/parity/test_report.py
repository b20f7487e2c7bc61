"""The report of parity says and draws measurements; here they are made by hand."""

from __future__ import annotations

import copy
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from tqdm import tqdm

from backends.mujoco.simulation import MujocoSimulation
from backends.parity import plots, report
from backends.parity.checks import Check
from backends.parity.one_state import compare, coordinate_names, one_state, random_states
from backends.parity.one_step import QUANTITIES, OneStep
from backends.parity.open_loop import OpenLoop, accurate_step, open_loop
from backends.parity.report import Parity, measure, show
from backends.parity.trajectories import Commands, random_commands
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.contract import Array

STEPS = np.array([4e-3, 2e-3, 1e-3])


def loop(commands: str) -> OpenLoop:
    """Return two engines, 3 mm and 1 mm off one limit for each ms of the step, in two episodes of
    three instants, of which the second ends after two."""
    tips = {"a": np.zeros((3, 3, 2, 3)), "b": np.zeros((3, 3, 2, 3))}
    tips["a"][..., 0], tips["b"][..., 0] = (k * STEPS[:, None, None] for k in (3, 1))
    for each in tips.values():
        each[:, 2, 1] = np.nan
    noise = np.array([[1e-6, 3e-6], [1e-6, 3e-6], [1e-6, np.nan]])
    switches = {"b:soft=no": 7e-5 * np.ones((3, 2))}
    time, ideal = np.array([0.004, 0.008, 0.012]), frozenset(tips)
    return OpenLoop(commands, STEPS, time, tips, noise, ideal, switches, arm_length=2.0)


def test_motions_as_small_as_rounding_tell_no_order() -> None:
    """Beside an arm of 1 km, 0.1 nm is rounding: there the second of two instants only rustles."""
    tips = 3 * STEPS[:, None, None, None] * np.ones((3, 2, 1, 3))
    tips[:, 1] = 1e-10 * np.array([1, -1, 1])[:, None, None]
    whole = replace(loop("random"), tips={"a": tips}, arm_length=1e3)
    assert whole.order("a") == pytest.approx(1)
    assert replace(whole, arm_length=1.0).order("a") < 0.6  # there it is a motion


def data_of(line: Line2D) -> tuple[Array, Array]:
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


@pytest.fixture
def parity() -> Parity:
    checks = [
        Check(1, "mass matrix", "b - a", 3e-13, 1e-10, "relative", "slide_3"),
        Check(1, "bias force", "b - a", 4e-5, 1e-10, "relative", "hinge_2_x"),
    ]
    numbers = np.arange(1.0, 102.0)
    differences = {q.name: 1e-6 * numbers * (k + 1) for k, q in enumerate(QUANTITIES)}
    sizes = {q.name: 0.02 * numbers for q in QUANTITIES}
    steps = [OneStep("random", "b - a", differences, sizes)]
    loops = [loop("demonstrator"), loop("random")]
    return Parity(load_robot("paper"), ("a", "b"), checks, steps, loops)


def test_the_text_has_the_numbers_in_their_units(parity: Parity) -> None:
    """Lengths are in mm and steps in ms; of 1 to 101 the median is 51 and the 95th percentile
    96."""
    text = show(parity)
    lines = [" ".join(line.split()) for line in text.splitlines()]
    for line in (
        "paper (fcc8bbe13d09f342): b against a",
        "ok mass matrix b - a 3.0e-13 relative (at most 1e-10)",
        "FAIL bias force b - a 4.0e-05 relative (at most 1e-10) at hinge_2_x",
        "2 one step: b - a, 101 states, random commands",
        "tip velocity 5.1e-05 9.6e-05 1.0e-04 1.9 m/s",
        "tension 2.0e-04 3.8e-04 4.0e-04 1.9 N",
        "3 open loop: 2 episodes, demonstrator commands, mean over time in [mm]",
        "time step in [ms] 4 2 1",
        "a, from its limit 12.0000 6.0000 3.0000 order 1.00",
        "b, from its limit 4.0000 2.0000 1.0000 order 1.00",
        "steps in [ms] with an error of 3 mm: a 1, b 3",
        "b - a 8.00000 4.00000 2.00000",
        "limit of b - a 0.0000",
        "b:soft=no moves it by 0.0700",
        "noise floor (commands off 1e-6) 0.00200",
    ):
        assert line in lines, f"{line} is not in\n{text}"
    stable = 1e3 * stable_step(parity.robot)
    assert lines[1] == f"time step 2.5 ms; no spring shakes below {stable:.4g} ms"
    # Differences are small beside 1.92; a mean of 8 mm is above 2e-3 x 2 m.
    failed = [" ".join((check.name, check.pair)) for check in parity.failed]
    assert failed == ["bias force b - a", "mean tip distance b - a, demonstrator"]
    assert lines[-1].startswith("14 of 16 checks hold; first failure: level 1, bias force, b - a: ")


@pytest.mark.parametrize(
    ("usual", "rare", "failed"),
    [
        (0.019, 0.19, []),
        (0.021, 0.19, [f"{q.name}, median" for q in QUANTITIES]),
        (0.019, 0.21, [f"{q.name}, 95 %" for q in QUANTITIES if q.name != "tension"]),
    ],
)
def test_half_the_steps_may_differ_by_a_hundredth_and_few_by_more_than_a_tenth(
    usual: float, rare: float, failed: list[str]
) -> None:
    """The quantities are 2 in size; 7 of 101 differences are rare."""
    differences = {q.name: np.repeat([usual, rare], [94, 7]) for q in QUANTITIES}
    part = OneStep("random", "b - a", differences, {q.name: np.full(101, 2.0) for q in QUANTITIES})
    assert [check.name for check in part.checks() if not check.passed] == failed


def test_the_report_measures_by_the_robots_own_ruler(parity: Parity) -> None:
    """The arm of 0.12 m is a twentieth of the paper's, and so is the error of 3 mm."""
    text = show(replace(parity, robot=load_robot("bench-arm")))
    assert "steps in [ms] with an error of 0.15 mm: a 0.05, b 0.15" in text


def test_the_plain_data_name_the_first_failure(parity: Parity) -> None:
    data = parity.as_dict()
    assert (data["passed"], data["reference"], data["engines"]) == (False, "a", ["a", "b"])
    assert str(data["first_failure"]).startswith("level 1, bias force, b - a: 4e-05 relative (at ")
    (whole, _), (step,) = data["open_loop"], data["one_step"]  # type: ignore[misc]
    assert whole["tip_distance"]["b"]["max"] == pytest.approx([8e-3, 4e-3, 2e-3])
    assert whole["noise_floor"] == {
        "disturbance": 1e-6,
        "mean": pytest.approx(2e-6),
        "max": pytest.approx(3e-6),
    }
    assert whole["switches"] == {"b:soft=no": pytest.approx({"mean": 7e-5, "max": 7e-5})}
    assert (whole["episodes"], whole["ideal"]) == (2, ["a", "b"])
    assert step["states"] == 101
    assert step["differences"]["base velocity"]["max"] == pytest.approx(2.02e-4)


def test_the_bar_counts_every_step_that_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, bars = load_robot("planar-single"), []

    class Bar(tqdm):  # type: ignore[type-arg]
        def __init__(self, total: int, unit: str, disable: bool | None) -> None:
            super().__init__(total=total, unit=unit, file=io.StringIO())
            self.hidden = disable
            bars.append(self)

    monkeypatch.setattr(report, "tqdm", Bar)
    engines = {"a": MujocoSimulation, "b": MujocoSimulation}
    switches = {"b": {"b:soft=no": MujocoSimulation}}
    runs = [random_commands(robot, 2, seed=0, steps=3), random_commands(robot, 1, seed=0, steps=2)]
    measure(robot, engines, runs, seed=0, progress=True, switches=switches)
    assert [bar.n for bar in bars] == [bar.total for bar in bars] == [(6 + 2) * (2 + 2 * 15 + 1)]
    measure(robot, engines, runs[1:], seed=0)
    assert [bar.hidden for bar in bars] == [None, True]  # on a terminal; nowhere


def figures_of(parity: Parity, patch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Return the figures by the names of their files, which are not written."""
    figures: dict[str, Figure] = {}

    @contextmanager
    def kept(path: Path, *_: object) -> Iterator[Figure]:
        figures[path.stem] = Figure()
        yield figures[path.stem]

    patch.setattr(plots, "drawn", kept)
    plots.draw(parity, Path("folder"))
    return figures


def test_the_figures_hold_the_measured_numbers(
    parity: Parity, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Distributions, errors over steps and distances over time, in [mm], [ms] and [s]."""
    figures = figures_of(parity, monkeypatch)
    assert list(figures) == ["paper-one-step", "paper-convergence", "paper-open-loop"]
    first, second, third = figures.values()
    for k, (panel, quantity) in enumerate(zip(first.axes, QUANTITIES, strict=True)):
        curve, size = panel.lines
        np.testing.assert_allclose(data_of(curve)[0], 1e-6 * np.arange(1, 102) * (k + 1))
        np.testing.assert_allclose(data_of(curve)[1], np.arange(1, 102) / 101)
        np.testing.assert_allclose(data_of(size)[0], [0.02 * 96] * 2)
        assert panel.get_xlabel() == f"{quantity.name} [{quantity.unit}]"
        assert (panel.get_xscale(), panel.get_xlim()[1]) == ("log", pytest.approx(2 * 1.92))
    assert [bool(panel.get_ylabel()) for panel in first.axes] == [True, False, True, False]
    for panel, part in zip(second.axes, parity.open_loop, strict=True):
        assert [panel.get_xscale(), panel.get_yscale()] == ["log", "log"]
        found = {line.get_label(): line for line in panel.lines}
        for label, values in (
            ("a from its limit", [12, 6, 3]),
            ("b from its limit", [4, 2, 1]),
            ("b from a", [8, 4, 2]),
            ("first order", [6, 3, 1.5]),
        ):
            np.testing.assert_allclose(data_of(found[label])[0], [4, 2, 1])
            np.testing.assert_allclose(data_of(found[label])[1], values, rtol=1e-9)
        assert panel.get_title() == f"{part.commands} commands; order: a 1.00, b 1.00"
        first_engine, other = (found[f"{name} from its limit"] for name in "ab")
        assert first_engine.get_markerfacecolor() == "none"  # open, so that others are seen in it
        assert first_engine.get_markersize() > 1.5 * other.get_markersize()
        assert other.get_markersize() == found["b from a"].get_markersize()
        assert [panel.xaxis.get_major_formatter()(2.0), *panel.get_xticks()] == ["2", 4, 2, 1]
        assert not panel.get_xticks(minor=True).size
    demonstrated, random = third.axes
    for panel in (demonstrated, random):
        found = {str(line.get_label()).partition(",")[0]: line for line in panel.lines}
        np.testing.assert_allclose(data_of(found["b from a"])[0], [0.004, 0.008, 0.012])
        np.testing.assert_allclose(data_of(found["b from a"])[1], 8.0)
        assert found["b from a"].get_color() == second.axes[0].lines[1].get_color()
        np.testing.assert_allclose(data_of(found["a"])[1], [0.002, 0.002, 0.001])  # medians
        assert panel.get_xlim() == (0, pytest.approx(0.012))
        band = panel.collections[-1].get_paths()[0].vertices
        np.testing.assert_allclose(np.unique(np.asarray(band)[:, 1]), [0.001, 0.003])  # the noise
    np.testing.assert_allclose(data_of(demonstrated.lines[-1])[1], 4.0)  # 2e-3 of 2 m, in [mm]
    assert len(random.lines) == len(demonstrated.lines) - 1
    assert all(len(figure.legends) == 1 for figure in figures.values())
    assert all(len({axes.get_ylim() for axes in each.axes}) == 1 for each in figures.values())
    assert first.axes[0].yaxis.get_major_formatter()(0.5) == "50%"


def test_each_of_many_engines_has_marks_and_a_colour_of_its_own(
    parity: Parity, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There are five marks and eight colours; engine after engine begins anew with them."""
    one, names = parity.open_loop[0], "abcdefg"
    tips = {name: (k + 1) * one.tips["b"] for k, name in enumerate(names)}
    parts = {"open_loop": [replace(one, tips=tips)], "one_step": 9 * parity.one_step}
    first, second, third = figures_of(replace(parity, **parts), monkeypatch).values()
    colors = [line.get_color() for line in first.axes[0].lines[:9]]
    assert len(set(colors[:8])) == 8
    assert colors[8] == colors[0]
    found = {str(line.get_label()): line for line in second.axes[0].lines}
    marks = [found[f"{name} from its limit"].get_marker() for name in names]
    assert len(set(marks)) == 5
    assert marks[5:] == marks[:2]
    assert [found[f"{name} from a"].get_marker() for name in names[1:]] == marks[1:]
    colors = [found[f"{name} from its limit"].get_color() for name in names]
    assert len(set(colors)) == len(names)
    found = {str(line.get_label()): line for line in third.axes[0].lines}
    assert [found[f"{name} from a"].get_color() for name in names[1:]] == colors[1:]


class Linear:
    """A tip at (sum of commands times time, error per step times step, 0), in [m]."""

    closed: ClassVar[list[int]] = []
    ideal, capabilities = True, frozenset[str]()

    def __init__(self, off: float, robot: Robot, num: int) -> None:
        self._h, self._x, self._y = robot.time_step, np.zeros(num), off * robot.time_step

    def step(self, command: Array, substeps: int = 1) -> None:
        self._x = self._x + command.sum(axis=1) * substeps * self._h

    def state(self) -> SimpleNamespace:
        tip = np.stack([self._x, np.full_like(self._x, self._y), 0 * self._x], axis=1)
        return SimpleNamespace(tip_position=tip)

    def close(self) -> None:
        self.closed.append(1)


def test_runs_of_known_motions_find_their_errors_and_steps() -> None:
    """Errors are 5 m/s and 2 m/s times the step; a disturbance is a millionth of the range."""
    robot, h = load_robot("planar-single"), load_robot("planar-single").time_step
    make: dict[str, Any] = {name: partial(Linear, off) for name, off in (("a", 5.0), ("b", 2.0))}
    assert accurate_step(robot, make["a"], 0.01) == pytest.approx(0.01 / 5)
    values = random_commands(robot, 200, seed=3, steps=30).values
    share, changes = values / robot.full_commands, (np.diff(values, axis=1) != 0).all(axis=(0, 2))
    assert 0 <= share.min() < 0.02 < 0.98 < share.max() <= 1
    assert np.flatnonzero(changes).tolist() == [9, 19]
    odd = random_commands(robot, 2, seed=3, steps=25).values / robot.full_commands
    np.testing.assert_allclose(odd[:, 4::10], np.random.default_rng(3).random((2, 3, 4)))
    runs, made = Commands("random", values, np.array([12, *[30] * 199])), []
    Linear.closed.clear()
    switched: Any = {"b": {"b:off=no": partial(Linear, 3.0)}}
    found = open_loop(robot, make, runs, made.append, switched)
    assert len(Linear.closed) == 2 * 4 + 1 + 1 + 2
    assert sum(made) == 200 * 30 * (2 * 15 + 1 + 1)
    np.testing.assert_allclose(found.time_steps, h / np.array([1, 2, 4, 8]))
    np.testing.assert_allclose(found.time, h * np.arange(1, 31))
    np.testing.assert_allclose(found.errors("a"), 5 * found.time_steps)
    np.testing.assert_allclose(found.mean_distance("b"), 3 * found.time_steps)
    assert found.accurate_step("b", 0.01) == pytest.approx(0.01 / 2)
    np.testing.assert_allclose(found.switches["b:off=no"][:12], 1 * h)
    path = np.cumsum(values.sum(axis=2).T * h, axis=0)
    np.testing.assert_allclose(found.tips["a"][3, :, 1:, 0], path[:, 1:])
    ended = np.argwhere(np.isnan(found.tips["a"][..., 0]).all(axis=0))
    assert ended.tolist() == [[step, 0] for step in range(12, 30)]
    spread = 1e-6 * np.linalg.norm(robot.full_commands) * h  # of the first step's sum
    assert np.sqrt(np.mean(found.noise[0] ** 2)) == pytest.approx(spread, rel=0.2)
    assert found.ideal == {"a", "b"}


def test_a_difference_is_measured_in_its_unit_and_its_place_is_named() -> None:
    """One entry of each part of the equation is changed at one of three states."""
    robot = load_robot("planar-single")
    simulation, states = MujocoSimulation(robot, 3), random_states(robot, 3, seed=1)
    simulation.set_snapshot(states)
    right = simulation.dynamics()
    wrong = copy.deepcopy(right)
    wrong.mass_matrix[2, 7, 9] += 3e-4 * np.prod(right.mass_matrix[2, [7, 9], [7, 9]]) ** 0.5
    wrong.bias_force[1, 20] -= 1e-3 * np.abs(right.bias_force[1]).max()
    wrong.passive_force[0, 6] += 2e-3 * np.abs(right.passive_force[0]).max()
    wrong.cable_length[1, 3] -= 5e-3
    columns = np.abs(right.cable_jacobian[:, :, 12]).max(axis=1)
    wrong.cable_jacobian[columns.argmin(), 1, 12] += 4e-3 * columns.min()
    wrong.tip_jacobian[1, 2, 11] += 1.0
    checks = {check.name: check for check in compare(robot, wrong, right, "b - a")}
    names = coordinate_names(robot)
    for name, value, where in (
        ("mass matrix", 3e-4, "slide_1, slide_3"),
        ("bias force", 1e-3, names[20]),
        ("passive force", 2e-3, "slide_0"),
        ("cable length", 5e-3, "cable_3"),
        ("cable Jacobian", 4e-3, f"cable_1, {names[12]}"),
    ):
        assert checks[name].value == pytest.approx(value), name
        assert (checks[name].where, checks[name].pair) == (where, "b - a")
    assert checks["generalized tip Jacobian"].where == f"z, {names[11]}"
    assert checks["cable length"].tolerance == pytest.approx(1e-9)
    assert {each.tolerance for name, each in checks.items() if name != "cable length"} == {1e-10}
    wrong.cable_length[0, 2] = np.nan
    (_, _, _, _, length, _) = compare(robot, wrong, right, "b - a")
    assert (length.value, length.where) == (np.inf, "cable_2")
    assert not any(check.value or check.where for check in compare(robot, right, right, "a - a"))


def test_single_precision_has_wider_tolerances() -> None:
    robot = load_robot("planar-single")

    class Single(MujocoSimulation):
        capabilities = MujocoSimulation.capabilities | {"single_precision"}

    for near, kinds in (((1e-10, 1e-4), (MujocoSimulation, Single)), ((1e-4,) * 2, (Single,) * 2)):
        checks = one_state(robot, dict(zip("ab", kinds, strict=True)), num=2)
        pairs = {"a - closed form": near[0], "b - closed form": near[1], "b - a": 1e-4}
        for check in checks:
            wide, length = pairs[check.pair], check.name == "cable length"
            expected = {1e-4: 3e-6, 1e-10: 1e-9}[wide] if length else wide
            assert check.tolerance == pytest.approx(expected)
