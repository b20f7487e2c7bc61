"""Rules of the tasks: episodes judged by hand, following's edge cases, and relabelling."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Array, State
from cdcsr.tasks.catalogue import TASKS, Capture, Follow, make_task
from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    DISTANCE,
    TARGET,
    TIP_POSITION,
    TIP_VELOCITY,
    observation_size,
    tip_distance,
    with_target,
)
from cdcsr.tasks.task import Task, Verdict, base_errors

SIZE = observation_size(load_robot("paper"))


def state(tip: Array, velocity: Array, shift: Array | None = None, tilt: float = 0.0) -> State:
    """Return a state with given tips, shape (num, 3), and a base moved by `shift` in [m] and turned
    by `tilt` about y in [rad]."""
    num = len(tip)
    resting = State(**{field.name: np.zeros((num, 3)) for field in dataclasses.fields(State)})
    turned = np.array([np.cos(tilt / 2), 0, np.sin(tilt / 2), 0])
    return dataclasses.replace(
        resting,
        tip_position=tip,
        tip_velocity=velocity,
        base_position=np.tile(np.zeros(3) if shift is None else shift, (num, 1)),
        base_quaternion=np.tile(turned, (num, 1)),
    )


def play(task: Task, tips: Array, speeds: Array, target_velocity: float = 0.0) -> list[Verdict]:
    """Return the verdicts on a tip that moves along x, with the target at the origin."""
    counts, verdicts = task.new_counts(1), []
    for x, v in zip(tips, speeds, strict=True):
        now = state(np.array([[x, 0, 0]]), np.array([[v, 0, 0]]))
        distance = tip_distance(now, np.zeros((1, 3)))
        verdicts.append(task.judge(now, np.array([[target_velocity, 0, 0]]), distance, counts))
    return verdicts


def succeeded(verdicts: list[Verdict]) -> list[int]:
    return [i for i, verdict in enumerate(verdicts, start=1) if verdict.success[0]]


def test_every_named_task_is_found_by_its_name() -> None:
    assert list(TASKS) == [
        "reach",
        "precise",
        "quiet",
        "capture",
        "capture-drift",
        "capture-tumble",
        "follow-line",
        "follow-circle",
        "follow-random",
    ]
    assert all(make_task(name) == task and task.name == name for name, task in TASKS.items())
    assert make_task("capture", motion="drift") == make_task("capture-drift")
    assert make_task("reach", threshold=0.01).name == "precise"
    assert make_task("capture", quiet=True, threshold=0.02).name == "capture-quiet-20mm"
    assert make_task("reach", threshold=None, reward_kind="dense").reward_kind == "dense"


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("captur", {}, r"Unknown task 'captur'\. Did you mean 'capture'\?"),
        ("capture", {"motion": "spin"}, r"Unknown motion 'spin'"),
        ("reach", {"threshold": 0.0}, "threshold must be positive and finite, not 0"),
        ("reach", {"threshold": np.inf}, "threshold must be positive and finite, not inf"),
        ("reach", {"max_steps": 10_000_001}, "max_steps must be a whole number from 1 to 10000000"),
    ],
)
def test_wrong_tasks_are_errors(name: str, changes: dict[str, object], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        make_task(name, None, **changes)


def test_the_numbers_behind_the_names_of_tasks() -> None:
    """They are written in the documentation; with others the same name would mean another task."""
    steps = {"follow": 1000, "capture": 500}
    for name, task in TASKS.items():
        own = 0.01 if name == "precise" else 0.03
        assert (task.threshold, task.max_steps) == (own, steps.get(task.kind, 250))
        assert task.quiet == (name == "quiet")
        assert (task.base_shift, task.base_tilt, task.period) == (0.003, 0.05, 0.0025)
    capture, follow = TASKS["capture"], TASKS["follow-line"]
    assert isinstance(capture, Capture)
    assert isinstance(follow, Follow)
    assert (capture.speed, capture.dwell, capture.motion) == (0.1, 0.1, "rest")
    assert (follow.settling, follow.share, follow.motion) == (0.625, 0.9, "line")
    assert make_task("reach", max_steps=10_000_000).max_steps == 10_000_000


def test_an_episode_has_an_action_however_long_a_step_is() -> None:
    paper = load_robot("paper")
    assert make_task("reach", paper.model_copy(update={"time_step": 9.0})).max_steps == 1
    assert make_task("reach", paper.model_copy(update={"time_step": 0.25})).max_steps == 2


def test_what_is_lost_has_achieved_nothing() -> None:
    lost, every = np.array([True, False]), np.array([True, True])
    assert [rows.tolist() for rows in Verdict(*[every] * 4).without(lost)] == [[False, True]] * 4


def test_a_look_without_an_action_counts_nothing() -> None:
    """The state is judged by the counts so far."""
    task, now, still = make_task("capture"), state(np.zeros((1, 3)), np.zeros((1, 3))), np.zeros(1)
    counts = {"dwelt": np.array([39])}
    for _ in range(3):
        verdict = task.judge(now, np.zeros((1, 3)), still, counts, count=False)
        assert (verdict.on_target[0], verdict.success[0]) == (True, False)
    assert counts["dwelt"].tolist() == [39]
    assert task.judge(now, np.zeros((1, 3)), still, counts).success[0]
    assert task.extra_info(now, counts)["dwelt"].tolist() == [pytest.approx(0.1)]


def test_capture_is_forty_steps_on_target_without_a_break() -> None:
    """0.1 s at 0.0025 s. After one step off the target, or too fast, the count starts again."""
    task, calm = make_task("capture"), np.zeros(200)
    near = np.full(200, 0.029)
    assert succeeded(play(task, near, calm))[0] == 40
    broken = near.copy()
    broken[39] = 0.031
    assert succeeded(play(task, broken, calm))[0] == 80
    fast = calm.copy()
    fast[9] = 0.101
    assert succeeded(play(task, near, fast))[0] == 50


def test_capture_ends_the_episode_and_is_rewarded_once_it_succeeds() -> None:
    verdicts = play(make_task("capture"), np.zeros(41), np.zeros(41))
    assert [bool(v.terminated[0]) for v in verdicts] == [False] * 39 + [True] * 2
    assert [bool(v.rewarded[0]) for v in verdicts] == [False] * 39 + [True] * 2
    assert all(v.on_target[0] for v in verdicts)


def test_capture_judges_the_speed_relative_to_the_target() -> None:
    task = make_task("capture-drift")
    moving = np.full(60, 0.3)
    assert succeeded(play(task, np.zeros(60), moving, target_velocity=0.25))[0] == 40
    assert succeeded(play(task, np.zeros(60), moving, target_velocity=0.19)) == []
    assert succeeded(play(task, np.zeros(60), np.zeros(60), target_velocity=0.1)) == []


def test_dwell_is_a_time_whatever_the_period() -> None:
    """0.1 s are 20 actions of 0.005 s, and 6 of 0.0175 s, as five take only 0.0875 s."""
    for period, actions in ((0.005, 20), (0.0175, 6)):
        task = make_task("capture", period=period)
        assert succeeded(play(task, np.zeros(50), np.zeros(50)))[0] == actions


@pytest.mark.parametrize(
    ("shift", "tilt", "expected"),
    [
        ([0, 0, 0], 0.0, True),
        ([0.002, 0.002, 0], 0.049, True),  # 2.83 mm
        ([0.003, 0.001, 0], 0.0, False),  # 3.16 mm
        ([0, 0, 0], 0.051, False),
        ([0, 0, 0], -0.051, False),
    ],
)
def test_quiet_counts_only_while_the_base_is_near_its_start(
    shift: list[float], tilt: float, expected: bool
) -> None:
    now = state(np.zeros((1, 3)), np.zeros((1, 3)), np.array(shift), tilt)
    for name in ("reach", "quiet"):
        task = make_task(name)
        verdict = task.judge(now, np.zeros((1, 3)), np.zeros(1), task.new_counts(1))
        assert bool(verdict.success[0]) == (expected or name == "reach")


def test_base_errors_are_distance_and_angle() -> None:
    """A quaternion and its negative are one rotation: 0.3 rad about (0.6, 0.8, 0)."""
    half = np.array([np.cos(0.15), 0.6 * np.sin(0.15), 0.8 * np.sin(0.15), 0])
    shift, tilt = base_errors(np.array([[3.0, 4, 12], [0, 0, 0]]), np.stack([half, -half]))
    np.testing.assert_allclose(shift, [13, 0])
    np.testing.assert_allclose(tilt, [0.3, 0.3], rtol=1e-12)


def follow(steps: int, off: list[int]) -> tuple[list[Verdict], Follow]:
    task = make_task("follow-line")
    assert isinstance(task, Follow)
    tips = np.zeros(steps)
    tips[np.array(off, dtype=int) - 1] = 1.0
    return play(task, tips, np.zeros(steps)), task


def test_follow_is_nine_in_ten_actions_after_settling() -> None:
    """The first 250 actions do not count. Of the next 100, ten may miss, eleven may not."""
    settling = list(range(1, 251))
    verdicts, _ = follow(350, settling + list(range(301, 311)))
    assert verdicts[-1].success[0]
    assert not verdicts[249].success[0]  # nothing has counted yet
    verdicts, _ = follow(350, settling + list(range(301, 312)))
    assert not verdicts[-1].success[0]


def test_follow_never_ends_by_itself_and_rewards_each_action_on_target() -> None:
    verdicts, task = follow(400, [5, 6])
    assert not any(v.terminated[0] for v in verdicts)
    rewards = [task.reward(np.zeros(1), v.rewarded)[0] for v in verdicts]
    assert rewards == [0.0 if i in (5, 6) else 1.0 for i in range(1, 401)]


def test_follow_reports_the_share_since_first_contact() -> None:
    """The tip misses in the first three of ten actions, then once more: six of seven."""
    task, report = make_task("follow-circle"), {}
    counts = task.new_counts(1)
    for x in (1, 1, 1, 0, 0, 1, 0, 0, 0, 0):
        now = state(
            np.array([[x, 0, 0]], dtype=float), np.zeros((1, 3)), np.array([0.003, 0.004, 0]), 0.2
        )
        task.judge(now, np.zeros((1, 3)), np.array([float(x)]), counts)
        report = task.extra_info(now, counts)
    np.testing.assert_allclose(report["share_on_target"], [6 / 7])
    np.testing.assert_allclose(report["base_position_error"], [0.005])
    np.testing.assert_allclose(report["base_attitude_error"], [0.2])


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("seed", range(4))
def test_first_success_is_that_of_playing_the_episode_again(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    task = (
        dataclasses.replace(make_task(name), settling=0.05)
        if name.startswith("follow")
        else make_task(name)
    )
    steps = 120
    # The tip passes the target slowly, sometimes too fast; the base is sometimes not quiet.
    tip = (
        0.05 * np.cos(np.linspace(0, 2, steps + 1))[:, None] * [1, 0, 0] * (seed != 3)
        + rng.normal(size=3) * 1e-3
    )
    speed = rng.choice([0.02, 0.2], p=[0.99, 0.01], size=(steps + 1, 1)) * [0, 0, 1]
    shift = rng.choice([0.001, 0.01], p=[0.9, 0.1], size=(steps + 1, 1)) * [0, 1, 0]
    quaternion = np.tile([1.0, 0, 0, 0], (steps + 1, 1))
    target = np.array([0.0, 0.0, 0.005])
    counts, expected, success = task.new_counts(1), None, False
    for i in range(1, steps + 1):
        now = dataclasses.replace(
            state(tip[i : i + 1], speed[i : i + 1]), base_position=shift[i : i + 1]
        )
        distance = tip_distance(now, target[None])
        success = bool(task.judge(now, np.zeros((1, 3)), distance, counts).success[0])
        if success and expected is None and task.kind != "follow":
            expected = i
    if task.kind == "follow":
        expected = steps if success else None
    assert task.first_success(tip, speed, target, shift, quaternion) == expected
    if seed == 3:
        assert expected is not None


def test_the_first_observation_is_no_success() -> None:
    tip = np.array([[0.0, 0, 0], [1, 0, 0], [0.02, 0, 0]])
    assert make_task("reach").first_success(tip, np.zeros((3, 3)), np.zeros(3)) == 2
    assert make_task("precise").first_success(tip, np.zeros((3, 3)), np.zeros(3)) is None
    for base in (None, np.zeros((3, 3))):
        with pytest.raises(ValueError, match="quiet task"):
            make_task("quiet").first_success(tip, np.zeros((3, 3)), np.zeros(3), base)


def test_relabelled_observations_differ_only_in_target_and_distance() -> None:
    observations = np.random.default_rng(0).normal(size=(5, SIZE))
    target = np.array([1.0, 2, 3])
    moved = with_target(observations, target)
    np.testing.assert_array_equal(moved[:, TARGET], np.tile(target, (5, 1)))
    for before, after in zip(observations, moved, strict=True):
        assert after[DISTANCE] == pytest.approx(
            sum((target[i] - before[i]) ** 2 for i in range(3)) ** 0.5
        )
    for rest in (TIP_POSITION, TIP_VELOCITY, slice(BASE_POSITION.start, None)):
        np.testing.assert_array_equal(moved[:, rest], observations[:, rest])


@pytest.mark.parametrize(("name", "expected"), [("reach", [0, 0, 1]), ("follow-line", [1, 0, 1])])
def test_rewards_of_an_episode(name: str, expected: list[float]) -> None:
    observations = np.zeros((4, SIZE))
    observations[1:, DISTANCE] = [0.01, 0.5, 0.02]
    assert make_task(name).episode_rewards(observations, True).tolist() == expected
    dense = make_task(name, reward_kind="dense").episode_rewards(observations, True)
    np.testing.assert_allclose(dense, np.array(expected) - [0.01, 0.5, 0.02])


@pytest.mark.parametrize(
    ("counted", "least"), [(1, 1), (5, 5), (9, 9), (10, 9), (11, 10), (19, 18), (20, 18)]
)
def test_nine_in_ten_is_no_less(counted: int, least: int) -> None:
    """For example 4 of 5 actions are 80 %, so all 5 must be on target."""
    task = Follow(settling=0.0)
    for hits in range(counted + 1):
        x = np.where(np.arange(counted + 1) <= hits, 0.0, 1.0)  # the first is before any action
        tip = x[:, None] * [1.0, 0.0, 0.0]
        success = task.first_success(tip, np.zeros_like(tip), np.zeros(3)) == counted
        assert success == (hits >= least) == (hits / counted >= 0.9)


def test_a_quiet_follower_is_rewarded_only_while_the_base_is_quiet() -> None:
    rows = np.zeros((5, observation_size(load_robot("paper"))))
    rows[:, BASE_QUATERNION.start] = 1.0
    rows[:, DISTANCE] = [0.5, 0.01, 0.01, 0.5, 0.01]
    rows[2, BASE_POSITION.start] = 0.01  # only after the second action
    for quiet, expected in ((True, [1, 0, 0, 1]), (False, [1, 1, 0, 1])):
        task = make_task("follow-line", quiet=quiet)
        assert task.episode_rewards(rows, False).tolist() == expected
