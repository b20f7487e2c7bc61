"""Evaluation and transfer: intervals, held-out targets, and the matrix."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cdcsr import cli
from cdcsr.envs.disturbances import Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names, engine_title
from controllers.jacobian import JacobianController
from tests.support.controllers import Still
from training.commands.evaluate import evaluate as evaluate_command
from training.commands.transfer import transfer as transfer_command
from training.config.seeds import TEST_SEED, VALIDATION_SEED
from training.measure.evaluation import Result, evaluate
from training.measure.statistics import wilson
from training.measure.transfer_matrix import (
    Cell,
    disagreements,
    format_table,
    other_targets,
    transfer,
)
from training.networks.actor import Actor
from training.plots import targets as figures
from training.policy import Policy, find_policy


@pytest.mark.parametrize(
    ("successes", "total"), [(0, 100), (97, 100), (100, 100), (1, 3), (50, 1000)]
)
def test_wilson_bounds_are_where_the_score_test_just_rejects(successes: int, total: int) -> None:
    low, high = wilson(successes, total)
    share = successes / total
    for bound in (low, high):
        if 0 < bound < 1:
            assert abs(share - bound) / np.sqrt(bound * (1 - bound) / total) == pytest.approx(
                1.959963984540054
            )
    assert (low == 0) == (successes == 0)
    assert (high == 1) == (successes == total)
    assert low <= share <= high


def test_failures_count_in_full_and_distances_are_the_last() -> None:
    robot = load_robot("paper")
    result = evaluate(Still(), robot, "mujoco", "anchor", episodes=5)
    assert result.rate == 0
    assert (result.length == 250).all()
    straight = np.array([0, 0, robot.top + robot.arm_length])
    np.testing.assert_allclose(
        result.distance, np.linalg.norm(result.targets - straight, axis=1), atol=1e-6
    )


def test_targets_depend_on_the_seed_alone() -> None:
    robot = load_robot("paper")
    a, b = (
        evaluate(Still(), robot, engine, "spatter", episodes=4).targets
        for engine in ("mujoco", "pybullet")
    )
    np.testing.assert_array_equal(a, b)
    other = evaluate(Still(), robot, "mujoco", "spatter", episodes=4, seed=VALIDATION_SEED).targets
    assert TEST_SEED != VALIDATION_SEED
    assert not np.isclose(a, other).any()


def test_frame_skip_counts_simulation_steps() -> None:
    robot = load_robot("paper")
    once, fivefold = (
        evaluate(JacobianController(robot), robot, "mujoco", "anchor", episodes=3, frame_skip=skip)
        for skip in (1, 5)
    )
    assert once.success.all()
    assert fivefold.success.all()
    assert (fivefold.length % 5 == 0).all()
    np.testing.assert_allclose(fivefold.length, once.length, rtol=0.35)


def test_full_packet_loss_blinds_a_policy_but_not_the_demonstrator() -> None:
    robot = load_robot("paper")
    lossy = Disturbances(packet_loss=1.0)
    policy = find_policy("batd3-spatter-mujoco")
    rates = [
        evaluate(policy, robot, "mujoco", "anchor", 10, disturbances=one).rate
        for one in (Disturbances(), lossy)
    ]
    assert rates[0] == 1
    assert rates[1] <= 0.5
    # The scripted controller asks the simulation, not the channel.
    assert (
        evaluate(JacobianController(robot), robot, "mujoco", "anchor", 2, disturbances=lossy).rate
        == 1
    )


def test_no_episodes_is_an_error() -> None:
    robot = load_robot("paper")
    with pytest.raises(CdcsrError, match="episodes must be a whole number from 1"):
        evaluate(Still(), robot, "mujoco", "anchor", episodes=0)
    with pytest.raises(CdcsrError, match="seed must be a whole number from 0"):
        evaluate(Still(), robot, "mujoco", "anchor", episodes=1, seed=-1)


def test_spaces_surround_the_centers_that_are_given() -> None:
    robot, far = load_robot("paper"), np.array([[0.0, 0.0, 9.0]])
    nearest = evaluate(Still(), robot, "mujoco", "floating", 3, frame_skip=50, centers=far).distance
    assert (nearest > 5).all()
    assert (evaluate(Still(), robot, "mujoco", "floating", 3, frame_skip=50).distance < 1).all()


def _cell(backend: str, success: list[bool]) -> Cell:
    done = np.array(success)
    result = Result(done, np.where(done, 100, 250), np.zeros(len(done)), np.zeros((len(done), 3)))
    return Cell("p", "mujoco", "spatter", backend, "anchor", result)


def test_other_targets_in_a_space_are_said_to_be() -> None:
    one, two = _cell("mujoco", [True, False]), _cell("pybullet", [True, False])
    elsewhere = replace(two.result, targets=two.result.targets + 0.1)
    assert other_targets([one, two, replace(one, controller="q")]) == []
    (said,) = other_targets(
        [one, replace(one, controller="q", result=elsewhere), replace(one, space="floating")]
    )
    assert said.startswith("q has other targets in anchor than p: ")


def test_disagreement_is_paired() -> None:
    cells = [
        _cell("mujoco", [True, True, False, False]),
        _cell("pybullet", [True, False, True, False]),
    ]
    (pair,) = disagreements(cells)
    assert (pair.only_first, pair.only_second, pair.share) == ([1], [2], 0.5)
    row = format_table(cells).splitlines()[2]
    assert "0.50 [0.15, 0.85]" in row
    assert "175.0 ± 75.0" in row
    assert "1 / 1" in row


def test_transfer_command_writes_every_cell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "transfer.json"
    transfer_command(["jacobian"], episodes=3, space="anchor", json=out)
    data = json.loads(out.read_text())
    found = [(cell["backend"], cell["success_rate"]) for cell in data["cells"]]
    assert found == [(engine, 1.0) for engine in backend_names()]
    assert data["disagreements"][0]["share"] == 0
    assert "| jacobian" in capsys.readouterr().out


def test_each_cell_is_a_panel_of_the_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[Path, list[str]] = {}
    monkeypatch.setattr(
        figures, "draw_targets", lambda results, _, path: drawn.update({path: list(results)})
    )
    one, all_spaces = tmp_path / "one.png", tmp_path / "all.png"
    evaluate_command("jacobian", episodes=1, space="anchor", plot=one)
    assert drawn[one] == [f"jacobian in {engine_title(engine)}" for engine in backend_names()]
    transfer_command(["jacobian"], episodes=1, backend="mujoco", plot=all_spaces)
    assert drawn[all_spaces] == [
        f"jacobian in MuJoCo, {space}" for space in ("anchor", "floating", "spatter")
    ]


def test_policies_of_one_name_are_told_apart(tmp_path: Path) -> None:
    policy, out = find_policy("batd3-spatter-mujoco"), tmp_path / "transfer.json"
    twin = tmp_path / "twin"
    policy.save(twin)
    names = ["jacobian", "batd3-spatter-mujoco", str(twin)]
    transfer_command(names, episodes=2, space="anchor", json=out)
    data = json.loads(out.read_text())
    engines = len(backend_names())
    assert len(data["cells"]) == 3 * engines
    assert len(data["disagreements"]) == 3 * engines * (engines - 1) / 2
    assert len({pair["controller"] for pair in data["disagreements"]}) == 3
    with pytest.raises(CdcsrError, match="different names"):
        transfer([policy, policy], policy.robot, ["mujoco"], ["anchor"], 2)
    with pytest.raises(CdcsrError, match="given twice"):
        transfer_command(["jacobian", "jacobian"])


def test_the_demonstrator_beside_a_policy_is_its_robots(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = load_robot("planar-single")
    torch.manual_seed(0)
    card = {"name": "p", "frame_skip": 1, "backend": "mujoco", "space": "anchor"}
    Policy(Actor(robot, False, (8,), "relu"), robot, np.zeros((1, 3)), card).save(tmp_path / "p")
    transfer_command(
        ["jacobian", str(tmp_path / "p")], episodes=1, space="anchor", backend="mujoco"
    )
    assert "| jacobian" in capsys.readouterr().out


def test_transfer_is_at_the_task_of_the_policies(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    policies = {}
    for task in ("precise", "quiet"):
        robot = load_robot("paper")
        card = {"name": task, "backend": "mujoco", "space": "anchor", "task": task, "frame_skip": 5}
        policies[task] = Policy(Actor(robot, False, (4,), "relu"), robot, np.zeros((1, 3)), card)
    monkeypatch.setattr("training.policy.find_policy", policies.get)
    out = tmp_path / "transfer.json"
    transfer_command(["precise"], backend="mujoco", episodes=1, space="anchor", json=out)
    assert json.loads(out.read_text())["task"] == "precise"
    with pytest.raises(
        CdcsrError, match=r"different tasks \(precise, quiet\); choose one with --task"
    ):
        transfer_command(["precise", "quiet"], backend="mujoco", episodes=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "nobody"], "Unknown policy 'nobody'"),
        (["evaluate", "jacobian", "--backend", "mojoco"], "Did you mean 'mujoco'?"),
        (["evaluate", "jacobian", "--space", "anker"], "Available: anchor, floating, spatter"),
        (["evaluate", "jacobian", "--task", "captur"], "Did you mean 'capture'?"),
        (["sweep", "jacobian", "--task", "captur"], "Did you mean 'capture'?"),
        (["sweep", "jacobian", "--axis", "link_mas"], "Did you mean 'link_mass'?"),
        (["evaluate", "jacobian", "--packet-loss", "2"], "packet_loss must lie in [0, 1]"),
        (["evaluate", "jacobian", "--seed", "-1"], "seed must be a whole number from 0"),
        (["transfer", "jacobian", "--robot-less", "x"], "robot-less"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_two(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = cli.main(arguments)
    except SystemExit as stopped:  # of the parser
        code = stopped.code
    assert code == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
