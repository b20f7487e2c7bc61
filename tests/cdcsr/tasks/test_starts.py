"""Starts have the declared bounds, are states of a real robot, and drift without consequence."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from backends.contract_suite.states import commands_of
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names, make_simulation
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks import starts
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import TARGET
from cdcsr.tasks.starts import RATE, SPEED, Starts, bank
from tests.support.physics import momentum, slack

SMALL = load_robot("planar-single")
PAPER = load_robot("paper")


def environment(
    num: int, robot: Robot, start: str, backend: str = "mujoco", **options: Any
) -> TaskVectorEnv:
    return TaskVectorEnv(
        num,
        robot,
        backend,
        start=start,
        autoreset_mode="Disabled",
        **options,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 6)])
def test_motions_are_uniform_in_size_and_direction(part: slice) -> None:
    num, most = 20_000, (SPEED, RATE)[part.start // 3]
    drawn = Starts("moving", SMALL).draw(np.random.default_rng(0), num)
    motion = drawn.velocity[:, part]
    size = np.linalg.norm(motion, axis=1)
    assert size.max() <= most
    # Of a uniform size in [0, 1]: quartiles within five standard errors.
    np.testing.assert_allclose(
        np.quantile(size / most, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=5 * 0.5 / num**0.5
    )
    direction = motion / size[:, None]
    np.testing.assert_allclose(direction.mean(0), 0, atol=5 / (3 * num) ** 0.5)
    np.testing.assert_allclose(direction.T @ direction / num, np.eye(3) / 3, atol=0.01)
    np.testing.assert_array_equal(drawn.drift, drawn.velocity[:, :3])
    assert not drawn.velocity[:, 6:].any()
    assert (drawn.position == [0, 0, 0, 1, *np.zeros(drawn.position.shape[1] - 4)]).all()


@pytest.mark.parametrize("robot", [PAPER, SMALL], ids=lambda robot: robot.name)
def test_bent_arms_are_states_of_the_robot(robot: Robot) -> None:
    """Cables are not too long and do not become longer than taut; the robot floated freely."""
    position, velocity = bank(robot, 0)
    with closing(make_simulation(robot, "mujoco", len(position))) as simulation:
        simulation.place(None, position, velocity)
        room = slack(robot, simulation)
        dynamics, state = simulation.dynamics(), simulation.state()
        linear, angular, _ = momentum(simulation)
    assert room.min() > -5e-5
    rate = np.einsum("ncj,nj->nc", dynamics.cable_jacobian, dynamics.velocity)
    assert rate[room < 1e-6].max() < 1e-3
    # Momentum of the parts, far above what is left of it in the sum (2.7 % of the base's at most).
    parts = np.abs(dynamics.mass_matrix[:, :3] * velocity[:, None]).sum((1, 2))
    assert np.linalg.norm(linear, axis=1).max() < 0.05 * parts.max()
    assert np.linalg.norm(angular, axis=1).max() < 0.05 * parts.max()
    assert (state.base_position == 0).all()
    assert (state.base_quaternion == [1, 0, 0, 0]).all()
    assert np.median(np.abs(state.joint_angles).max(1)) > 0.05
    assert np.median(np.linalg.norm(state.tip_velocity, axis=1)) > 0.2
    assert np.median(state.cable_travel.min(1)) < -1e-4


def test_a_smaller_and_faster_robot_starts_with_motions_of_its_size() -> None:
    """A quarter of the lengths in half of the time: half the speed, twice the rate."""
    assert (SPEED, RATE, starts.HOLD, starts.BANK) == (0.02, 0.02, 0.2, 256)  # as documented
    scale = ruler(SMALL).scale.model_copy(update={"length": 0.6, "time": 0.180673 / 2})
    robot = SMALL.model_copy(update={"scale": scale})
    drawn = Starts("moving", robot).draw(np.random.default_rng(0), 5000).velocity
    assert 0.0099 < np.linalg.norm(drawn[:, :3], axis=1).max() <= 0.01
    assert 0.0396 < np.linalg.norm(drawn[:, 3:6], axis=1).max() <= 0.04


def test_bent_arms_on_a_light_base_float_freely_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a base turns far, and is turned back with all that moves."""
    monkeypatch.setattr(starts, "BANK", 32)
    monkeypatch.setattr(starts, "_BANKS", {})
    data = PAPER.model_dump()
    data["base"] |= {"mass": 20.0, "inertia": (1.0, 1.1, 1.2)}
    robot = Robot.model_validate(data)
    position, velocity = bank(robot, 0)
    assert position.shape == (32, robot.num_coordinates + 1)
    with closing(make_simulation(robot, "mujoco", 32)) as simulation:
        simulation.place(None, position, velocity)
        mass = simulation.dynamics().mass_matrix
    moving = np.abs(mass[:, :6] * velocity[:, None]).sum(2)
    rest = np.abs(np.einsum("nij,nj->ni", mass[:, :6], velocity))
    assert np.linalg.norm(velocity[:, 3:6], axis=1).max() > 1
    assert (rest < 0.05 * moving.max()).all()


def test_a_bent_arm_was_pulled_twice_and_is_kept_at_the_end_of_both(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each command lasts from one step to 0.2 s, 80 steps. The states in the bank are those of the
    steps in which a copy's commands change or end."""
    taken: list[tuple[Array, Array]] = []

    class Logged(MujocoSimulation):
        def step(self, command: Array, substeps: int = 1) -> None:
            super().step(command, substeps)
            taken.append((command.copy(), self.get_snapshot().position[:, 7:]))

    monkeypatch.setattr(starts, "BANK", 48)
    monkeypatch.setattr(starts, "_BANKS", {})
    monkeypatch.setattr(starts, "make_simulation", lambda robot, _, num: Logged(robot, num))
    kept = bank(SMALL, 0)[0][:, 7:].reshape(2, 24, -1)
    commands, joints = (np.array(column) for column in zip(*taken, strict=True))
    lasted = []
    for copy in range(24):
        at = [(joints[:, copy] == kept[which, copy]).all(1).argmax() + 1 for which in (0, 1)]
        first, second = commands[: at[0], copy], commands[at[0] : at[1], copy]
        assert (joints[np.subtract(at, 1), copy] == kept[:, copy]).all()
        assert (first == first[0]).all()
        assert (second == second[0]).all()
        assert (first[0] != second[0]).all()
        lasted += [at[0], at[1] - at[0]]
    assert 1 <= min(lasted) < 8
    assert 72 < max(lasted) <= 80
    pulls = -commands[0] / [servo.eta for servo in SMALL.servos]
    assert 0 <= pulls.min() < 0.05
    assert 0.95 < pulls.max() <= 1


def test_a_bank_is_determined_by_its_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    first, other = bank(SMALL, 0), bank(SMALL, 1)
    monkeypatch.setattr(starts, "_BANKS", {})
    again = bank(SMALL, 0)
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[1], first[1])
    assert not np.isclose(first[0][:, 7:], other[0][:, 7:]).all(1).any()


def test_a_start_does_not_change_the_bank() -> None:
    before = [rows.copy() for rows in bank(SMALL, 0)]
    env = environment(64, SMALL, "anywhere")
    env.randomization = Randomization(SMALL, 64, 1.0, np.random.default_rng(0))
    env.reset(seed=0)
    env.close()
    for mine, rows in zip(before, bank(SMALL, 0), strict=True):
        np.testing.assert_array_equal(mine, rows)


@pytest.mark.parametrize(
    "options", [{}, {"task": "capture", "motion": "circle"}, {"frame_skip": 3}]
)
def test_a_drift_is_not_felt(monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]) -> None:
    """Galileo: seen from the frame that drifts, robot and target move as those that are still."""
    monkeypatch.setattr(starts, "RATE", 0.0)
    found: list[tuple[Array, Array, Array]] = []
    commands = commands_of(PAPER, 60, 3, hold=15)
    for start in ("still", "moving"):
        env = environment(3, PAPER, start, **options)
        env.reset(seed=4)
        assert (np.linalg.norm(env.drift, axis=1) > 1e-3).all() == (start == "moving")
        rows = []
        for command in commands:
            info = env.step(command)[4]
            state = env.simulation.state()
            drifted = env.drift * state.time[:, None]
            rows.append((info["distance"], state.tip_position - drifted, env.targets - drifted))
        distances, tips, targets = (np.array(column) for column in zip(*rows, strict=True))
        found.append((distances, tips, targets))
        env.close()
    for still, moving in zip(*found, strict=True):
        np.testing.assert_allclose(moving, still, rtol=0, atol=1e-11)


@pytest.mark.parametrize("start", ["moving", "anywhere"])
def test_the_same_seed_gives_the_same_starts_everywhere(start: str) -> None:
    """In one environment and in many, in every engine; and the targets of the still start."""
    found = []
    for backend in backend_names():
        env = environment(1, SMALL, start, backend)
        env.reset(seed=3)
        snapshot = env.simulation.get_snapshot()
        found.append(np.concatenate([snapshot.position, snapshot.velocity], axis=1))
        np.testing.assert_allclose(found[-1], found[0], rtol=0, atol=1e-12)
        env.close()
    many = gym.make_vec("cdcsr/Reach-v0", num_envs=1, robot=SMALL, start=start)
    one = gym.make("cdcsr/Reach-v0", robot=SMALL, start=start)
    still = environment(1, SMALL, "still")
    seen, alone = many.reset(seed=3)[0], one.reset(seed=3)[0]
    still.reset(seed=3)
    np.testing.assert_array_equal(seen[0], alone)
    np.testing.assert_array_equal(seen[:, TARGET], still.targets)
    for each in (many, one, still):
        each.close()


@pytest.mark.parametrize("start", ["moving", "anywhere"])
def test_a_saved_environment_goes_on_with_the_same_starts(start: str) -> None:
    commands = commands_of(SMALL, 40, 4)

    def run(env: TaskVectorEnv, steps: slice) -> list[Array]:
        return [env.step(command)[0] for command in commands[steps]]

    options = {"task": "reach", "max_steps": 7, "motion": "drift", "start": start}
    first, second = (TaskVectorEnv(4, SMALL, **options) for _ in range(2))  # type: ignore[arg-type]
    first.reset(seed=1)
    run(first, slice(0, 10))
    saved = first.get_state()
    expected = run(first, slice(10, 40))
    second.set_state(saved)
    np.testing.assert_array_equal(run(second, slice(10, 40)), expected)
    first.close()
    second.close()


def test_short_cables_are_taut_and_not_stretched_at_the_start() -> None:
    """Plants with cables up to 2 cm shorter begin bent with no cable too long."""
    env = environment(64, PAPER, "anywhere")
    env.randomization = Randomization(PAPER, 64, 1.0, np.random.default_rng(0))
    env.reset(seed=0)
    state, route = env.simulation.state(), routing(PAPER)
    length = cable_lengths(route, state.cable_travel, state.joint_angles)
    offset = env.simulation.plant.rest_length_offset
    assert offset.min() < -0.015
    assert (length - route.rest_length - offset).max() < 5e-5
    env.close()


def test_impossible_starts_are_errors() -> None:
    with pytest.raises(CdcsrError, match=r"Unknown start 'anywere'. Did you mean 'anywhere'"):
        Starts("anywere", SMALL)
    with pytest.raises(CdcsrError, match=r"the base drifts by itself.*choose start 'still'"):
        environment(1, SMALL, "moving", task="quiet")


@pytest.mark.parametrize(
    ("base", "start", "task", "message"),
    [
        ({"mount": "fixed"}, "moving", "reach", "and that of 'paper' is fixed; choose start"),
        ({"position": (0.0, 0.0, 1.0)}, "anywhere", "reach", "start 'anywhere' is for a base that"),
        ({"quaternion": (0.0, 1.0, 0.0, 0.0)}, "still", "quiet", "task 'quiet' is for a base that"),
    ],
)
def test_starts_that_a_base_cannot_have(
    base: dict[str, object], start: str, task: str, message: str
) -> None:
    paper = load_robot("paper")
    robot = paper.model_copy(update={"base": paper.base.model_copy(update=base)})
    Starts("still", robot).check(make_task("reach"))
    with pytest.raises(CdcsrError, match=message):
        Starts(start, robot).check(make_task(task))
