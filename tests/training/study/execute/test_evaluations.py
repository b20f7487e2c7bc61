"""The study's evaluations: their requests, and their results read back."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import State
from cdcsr.simulation.engines import backend_names, principal_engines
from cdcsr.tasks.spaces import make_space
from cdcsr.tasks.target_motion import make_motion
from controllers.controller import Controller, Target
from tests.support.tiny import CENTERS, Options
from training.config.run_description import RunDescription
from training.config.seeds import TEST_SEED
from training.measure import evaluation
from training.measure import following as following
from training.measure.evaluation import Result
from training.measure.following import Following, follow
from training.policy import Policy
from training.study.execute import evaluations
from training.study.execute.evaluations import EVALUATIONS, Subject
from training.study.report.paper_numbers import TABLE_4
from training.study.report.records import episodes_of
from training.study.store import FOLLOW_KINDS, read_csv, read_episodes

Array = NDArray[np.float64]


class Measured:
    """In place of `evaluate`: notes what is asked for, and answers at random."""

    def __init__(self) -> None:
        self.asked: list[Options] = []
        self.results: list[Result] = []

    def __call__(self, *arguments: object, **options: object) -> Result:
        bound = inspect.signature(evaluation.evaluate).bind(*arguments, **options)
        bound.apply_defaults()
        self.asked.append(bound.arguments)
        rng, num = np.random.default_rng(len(self.asked)), bound.arguments["episodes"]
        self.results.append(
            Result(
                rng.random(num) < 0.5,
                rng.integers(2, 250, num),
                rng.random(num),
                np.zeros((num, 3)),
            )
        )
        return self.results[-1]


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> Measured:
    measured = Measured()
    monkeypatch.setattr(evaluations, "evaluate", measured)
    return measured


def test_disturbances_are_table_4s_one_at_a_time_where_the_run_was_trained(
    measured: Measured, policy: Policy
) -> None:
    subject = Subject(
        RunDescription(algorithm="batd3", backend="pybullet", space="floating"),
        policy,
        policy.robot,
    )
    rows = list(EVALUATIONS["disturbances"].measure(subject, 2))
    cells = list(dict.fromkeys((row[2], float(row[3])) for row in rows))
    assert {*cells} | {(axis, 0.0) for axis, _ in cells} == {
        (axis, level) for axis, level, _ in TABLE_4
    }
    wanted: list[Options] = [{str(axis): level} for axis, level in cells]
    assert [one["disturbances"] for one in measured.asked] == [
        Disturbances(**one) for one in wanted
    ]
    for asked in measured.asked:
        assert (asked["backend"], asked["space"], asked["task"]) == (
            "pybullet",
            "floating",
            "reach",
        )
    assert {row[:2] for row in rows} == {("pybullet", "floating")}


@pytest.mark.parametrize("name", ["nominal", "workspace", "disturbances"])
def test_a_policy_is_measured_as_it_acts_on_the_held_out_targets(
    name: str, measured: Measured, policy: Policy
) -> None:
    subject = Subject(
        RunDescription(algorithm="batd3", backend="pybullet", space="floating"),
        policy,
        policy.robot,
    )
    list(EVALUATIONS[name].measure(subject, 2))
    assert measured.asked
    for asked in measured.asked:
        assert asked["controller"] is policy
        assert (asked["seed"], asked["frame_skip"], asked["episodes"]) == (TEST_SEED, 5, 2)
        assert asked["centers"] is policy.centers


@pytest.mark.parametrize(
    ("task", "space", "spaces"),
    [
        ("reach", "floating", {"anchor", "floating", "spatter"}),
        ("reach", "workspace", {"workspace"}),
        ("capture", "anchor", {"anchor"}),
    ],
)
def test_only_reaching_in_a_space_of_the_paper_is_tested_in_all_of_them(
    task: str, space: str, spaces: set[str], measured: Measured, policy: Policy
) -> None:
    rows = list(
        EVALUATIONS["nominal"].measure(
            Subject(RunDescription(algorithm="bc", space=space, task=task), policy, policy.robot), 1
        )
    )
    assert {(asked["backend"], asked["space"]) for asked in measured.asked} == {
        row[:2] for row in rows
    }
    assert {row[:2] for row in rows} == {
        (engine, one) for engine in backend_names() for one in spaces
    }
    assert {asked["task"] for asked in measured.asked} == {task}


def test_what_was_measured_is_what_is_read(
    measured: Measured, policy: Policy, tmp_path: Path
) -> None:
    subject = Subject(RunDescription(algorithm="batd3", space="anchor"), policy, policy.robot)
    EVALUATIONS["disturbances"].write(tmp_path / "disturbances.csv", subject, 6)
    found = episodes_of(read_episodes(tmp_path / "disturbances.csv"))
    assert len(found) == 6 * len(measured.asked)
    for asked, result in zip(measured.asked, measured.results, strict=True):
        strength = asked["disturbances"]
        axis = next(
            (x for x in ("base_noise", "packet_loss") if getattr(strength, x)), "action_noise"
        )
        cell = found.where(
            backend="mujoco", space="anchor", axis=axis, level=getattr(strength, axis)
        )
        assert cell.episode.tolist() == list(range(6))
        assert cell.success.tolist() == result.success.tolist()
        assert cell.length.tolist() == result.length.tolist()


def test_following_is_of_the_policy_in_its_space_and_read_as_it_was(
    policy: Policy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Options] = []

    def followed(*arguments: object, **options: object) -> list[Following]:
        bound = inspect.signature(following.follow).bind(*arguments, **options)
        bound.apply_defaults()
        asked.append(bound.arguments)
        return [Following(bound.arguments["motion"], 0, 125, 0.01, 0.002, 0.03)]

    monkeypatch.setattr(evaluations, "follow", followed)
    subject = Subject(RunDescription(algorithm="batd3", space="floating"), policy, policy.robot)
    EVALUATIONS["follow"].write(tmp_path / "follow.csv", subject, 100)
    columns = read_csv(tmp_path / "follow.csv", FOLLOW_KINDS)
    motions = [
        (engine, motion)
        for engine in principal_engines()
        for motion in ("line", "circle", "random")
    ]
    assert [(one["backend"], one["motion"]) for one in asked] == motions
    assert [*zip(columns["backend"].tolist(), columns["motion"].tolist(), strict=True)] == motions
    for one in asked:
        assert (one["controller"], one["space"], one["episodes"], one["frame_skip"]) == (
            policy,
            "floating",
            10,
            5,
        )
        assert one["centers"] is policy.centers
    assert set(columns["step"]) == {125}
    shown = [
        set(columns[name]) for name in ("tip_error", "base_position_error", "base_attitude_error")
    ]
    assert shown == [{0.01}, {0.002}, {0.03}]


class Pulling(Controller):
    """Pulls one cable, and notes how the robot stands before each action."""

    name = "pulling"

    def __init__(self) -> None:
        self.tip: list[Array] = []
        self.position: list[Array] = []
        self.quaternion: list[Array] = []

    def act(self, state: State, target: Target, time: Array) -> Array:
        self.tip.append(state.tip_position.copy())
        self.position.append(state.base_position.copy())
        self.quaternion.append(state.base_quaternion.copy())
        commands = np.zeros_like(state.cable_travel)
        commands[:, 0] = -1.0
        return commands


@pytest.mark.parametrize("motion", ["line", "circle"])
def test_following_starts_at_the_held_out_targets_and_tells_each_error_by_its_name(
    motion: str, paper: Robot
) -> None:
    """Against targets that are drawn and moved here, and a robot that is watched from outside."""
    controller, num = Pulling(), 2
    samples = list(
        follow(controller, paper, "mujoco", "floating", motion, num, CENTERS, frame_skip=5)
    )
    rng, moves = np.random.default_rng(TEST_SEED), make_motion(motion)
    target = make_space("floating", paper, CENTERS).sample(rng, num)
    velocity, memory = moves.begin(rng, target)
    assert [(one.episode, one.step) for one in samples] == [
        (i, 125 * k) for k in range(1, 9) for i in range(num)
    ]
    for k in range(1, 8):  # of the last nobody is asked any more
        for _ in range(125):
            moves.advance(target, velocity, memory, paper.time_step)
        rows = samples[num * (k - 1) : num * k]
        tip, position, quaternion = (
            x[25 * k] for x in (controller.tip, controller.position, controller.quaternion)
        )
        np.testing.assert_allclose(
            [r.tip_error for r in rows], np.linalg.norm(target - tip, axis=1), rtol=1e-9
        )
        np.testing.assert_allclose(
            [r.base_position_error for r in rows], np.linalg.norm(position, axis=1), rtol=1e-9
        )
        angle = 2 * np.arccos(np.minimum(np.abs(quaternion[:, 0]), 1))
        np.testing.assert_allclose([r.base_attitude_error for r in rows], angle, rtol=1e-4)
        assert angle.min() > 1e-3


@pytest.mark.usefixtures("measured")
def test_transfer_is_measured_in_every_engine_where_it_was_trained(policy: Policy) -> None:
    subject = Subject(RunDescription(algorithm="batd3", space="spatter"), policy, policy.robot)
    rows = list(EVALUATIONS["engines"].measure(subject, 1))
    assert [row[:2] for row in rows] == [(engine, "spatter") for engine in backend_names()]
