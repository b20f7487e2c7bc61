"""The search for better commands: its offsets, its rounds, and which commands are kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.simulation.contract import State
from cdcsr.tasks.observation import BASE_POSITION, DISTANCE, SLICES, TIP_POSITION
from controllers import search
from controllers.controller import Controller, Target
from controllers.rollout import Rollout, rollout
from controllers.search import FOLLOWED, HOLD, KEPT, LEAST_WIDTH, WIDTH, Nudged, Outcome, improve
from tests.support.controllers import Stepper, Still

Array = NDArray[np.float64]


class Slack(Controller):
    """Pulls one cable of each segment, on one side, and no other cable."""

    name = "slack"

    def __init__(self, pull: float = 0.0) -> None:
        self.pull = pull

    def act(self, state: State, target: Target, time: Array) -> Array:
        commands = np.zeros_like(state.cable_travel)
        commands[:, 0] = commands[:, 4] = -self.pull
        return commands


def _envs(num: int, steps: int = 250, threshold: float = 0.03, noise: float = 0.0) -> TaskVectorEnv:
    return TaskVectorEnv(
        num,
        max_steps=steps,
        threshold=threshold,
        disturbances=Disturbances(noise),
        autoreset_mode="Disabled",
    )


def test_offsets_are_added_held_and_clipped_for_each_copy() -> None:
    env = _envs(2)
    plans = np.zeros((2, 25, 8))
    plans[0, 0, 1], plans[1, 1, 2], plans[1, 1, 0] = -0.5, -9.0, 3.0
    stepper = Stepper(Nudged(Slack(1.0), plans), env, seed=0)
    for step in range(2 * HOLD):
        expected = np.zeros((2, 8))
        expected[:, 0] = expected[:, 4] = -1
        if step < HOLD:
            expected[0, 1] = -0.5
        else:
            expected[1, 2], expected[1, 0] = -5.0, 0.0
        np.testing.assert_array_equal(stepper.command(), expected)
        stepper.step()
    env.close()


def test_outcomes_sort_by_how_often_then_how_soon_then_how_near() -> None:
    best_first = [
        Outcome(1.0, 90, 0.03),
        Outcome(1.0, 91, 0.01),
        Outcome(0.5, 80, 0.02),
        Outcome(0.0, 250, 0.04),
        Outcome(0.0, 250, 0.05),
    ]
    assert sorted(reversed(best_first), key=lambda outcome: outcome.order) == best_first


def test_a_target_that_is_known_to_be_reachable_is_come_near_to() -> None:
    """A pull on one side brings the tip to the target; a controller that does nothing fails."""
    env = _envs(24, 60)
    probe = _envs(1, 60, threshold=1e-9)
    observation, _ = probe.reset(seed=0)
    start = observation[0, TIP_POSITION].copy()
    end = rollout(Slack(5.0), probe, observation).observations[0, -1, TIP_POSITION]
    assert np.linalg.norm(end - start) > 0.1
    alone, best = improve(Slack(), env, end, 12, 0)
    assert (alone.reached, alone.length) == (0, 60)
    assert best.nearest < 0.5 * alone.nearest  # whatever the seed: 0.03 to 0.06 of 0.15 m
    assert (best.reached == 1) == (best.nearest <= 0.03)
    assert improve(Slack(), env, end, 1, 0)[1].nearest > best.nearest
    for each in (env, probe):
        each.close()


def test_what_is_found_is_hardly_worse_and_is_not_sought_where_it_is_not_wanted() -> None:
    env = _envs(6, 20, noise=1.0)
    target = np.array([0.2, 0.1, 2.5])
    alone, best = improve(Slack(), env, target, 1, 0)
    assert best.nearest < alone.nearest + 0.02  # of tries drawn anew
    calls = []

    class Counted(Slack):
        def act(self, state: State, target: Target, time: Array) -> Array:
            calls.append(1)
            return super().act(state, target, time)

    assert improve(Counted(), env, target, 3, 0, lambda outcome: outcome.reached > 0) == (
        alone,
        alone,
    )
    assert len(calls) == 20
    env.close()


def test_nearest_is_of_the_plant_and_not_what_a_lossy_link_shows() -> None:
    env = TaskVectorEnv(
        2,
        max_steps=200,
        threshold=1e-9,
        autoreset_mode="Disabled",
        disturbances=Disturbances(0.0, 0.0, 1.0),
    )
    observation, _ = env.reset(seed=0)
    targets, tips = env.targets.copy(), []

    class Watched(Slack):
        def act(self, state: State, target: Target, time: Array) -> Array:
            tips.append(env.simulation.state().tip_position.copy())
            self.pull = 5.0 if len(tips) <= 60 else 0.0
            return super().act(state, target, time)

    result = rollout(Watched(), env, observation)
    assert np.ptp(result.observations[..., DISTANCE], axis=1).max() == 0  # nothing arrives
    far = np.linalg.norm(
        np.array([*tips[1:], env.simulation.state().tip_position]) - targets, axis=-1
    )
    np.testing.assert_allclose(result.nearest, far.min(0), rtol=1e-12)
    assert (result.nearest < result.distance).any()
    env.close()


class Landscape:
    """Replaces episodes: the length of one is a function of its plan and of chance."""

    def __init__(
        self, length: Callable[[Array, np.random.Generator], float], chance: float = 1.0
    ) -> None:
        self.length, self.chance, self.rng, self.tries = length, chance, np.random.default_rng(0), 0

    def __call__(self, controller: Nudged, env: TaskVectorEnv, _: Array) -> Rollout:
        self.tries += 1
        plans, num, nothing = controller._plans, env.num_envs, np.zeros(0)
        length = np.array([round(self.length(plan, self.rng)) for plan in plans])
        success = self.rng.random(num) < self.chance
        return Rollout(
            nothing,
            nothing,
            nothing,
            nothing,
            success,
            success,
            np.where(success, length, 250),
            nothing,
            np.ones(num),
        )


def _improve(
    monkeypatch: pytest.MonkeyPatch, landscape: Landscape, num: int, rounds: int
) -> tuple[Outcome, Outcome]:
    monkeypatch.setattr(search, "rollout", landscape)
    env = _envs(num)
    try:
        return improve(Slack(), env, np.array([0.2, 0.1, 2.5]), rounds, 1)
    finally:
        env.close()


def test_where_luck_is_great_the_middle_of_the_round_is_what_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The luckiest plan of all rounds is not good again; the middle of the last ones is."""

    def length(plan: Array, rng: np.random.Generator) -> float:
        far = np.square(plan[0] / 5 - 0.5).mean()
        return 30 if far > 0.15 and rng.random() < 0.03 else 60 + 200 * far

    alone, best = _improve(monkeypatch, Landscape(length), 48, 15)
    assert alone.length > 100
    assert best.length < 80


def test_where_one_plan_stands_out_that_plan_is_what_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One in forty takes half the time, and the middle of those that are kept does not."""

    def length(plan: Array, rng: np.random.Generator) -> float:  # noqa: ARG001
        return 50 if plan[0, 0] > 2 * search.WIDTH * 5 else 100

    alone, best = _improve(monkeypatch, Landscape(length), 48, 2)
    assert (alone.length, best.length) == (100, 50)


def test_where_the_controller_does_best_nothing_else_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def length(plan: Array, rng: np.random.Generator) -> float:  # noqa: ARG001
        return 100 if not plan.any() else 200

    alone, best = _improve(monkeypatch, Landscape(length), 12, 3)
    assert (alone.length, best.length) == (100, 100)


def test_what_is_told_is_not_the_luck_of_the_tries_that_chose_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every plan succeeds half of the time; the best of three sets of six tries would say 0.66."""
    landscape = Landscape(lambda plan, rng: 100.0, 0.5)  # noqa: ARG005
    told = np.array(
        [
            [outcome.reached for outcome in _improve(monkeypatch, landscape, 6, 1)]
            for _ in range(150)
        ]
    )
    assert np.abs(told.mean(0) - 0.5).max() < 0.06  # four standard errors


NUM = 24
TARGET = np.array([0.2, 0.1, 2.5])


class Known:
    """Replaces episodes: a function of the plan gives length (None if it fails) and distance."""

    def __init__(self, outcome: Callable[[Array], tuple[float | None, float]]) -> None:
        self.outcome, self.plans, self.observations = outcome, list[Array](), list[Array]()

    def __call__(self, controller: Nudged, env: TaskVectorEnv, observation: Array) -> Rollout:
        self.plans.append(np.array(controller._plans))
        self.observations.append(observation.copy())
        found = [self.outcome(plan) for plan in controller._plans]
        success = np.array([length is not None for length, _ in found])
        length = np.array([250 if length is None else round(length) for length, _ in found])
        nearest, nothing = np.array([near for _, near in found]), np.zeros(0)
        # In the end a plan that was near is far: only on the way it was not.
        return Rollout(
            nothing, nothing, nothing, nothing, success, success, length, 1 - nearest, nearest
        )

    def best(self) -> tuple[float, float, float]:
        """Return whether any plan succeeded, the least length of a success, the least distance."""
        found = [self.outcome(plan) for tried in self.plans for plan in tried]
        lengths = [round(length) for length, _ in found if length is not None]
        return float(bool(lengths)), min(lengths, default=250), min(near for _, near in found)


def improved(
    monkeypatch: pytest.MonkeyPatch, known: Known, rounds: int, noise: float = 0.0
) -> tuple[Outcome, Outcome, Array]:
    """Return the two outcomes, and eta."""
    monkeypatch.setattr(search, "rollout", known)
    env = TaskVectorEnv(
        NUM,
        "planar-single",
        max_steps=25,
        autoreset_mode="Disabled",
        disturbances=Disturbances(base_noise=noise),
    )
    try:
        eta = np.array([servo.eta for servo in env.robot.servos])
        return *improve(Still(), env, TARGET, rounds, 1), eta
    finally:
        env.close()


def test_where_all_miss_the_plan_that_came_nearest_is_what_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = Known(lambda plan: (None, 0.5 + 0.01 * plan[1, 0]))
    alone, best, _ = improved(monkeypatch, known, 1)
    assert (alone.reached, alone.nearest) == (0, 0.5)
    assert best.nearest == known.best()[2] < 0.5


def test_a_plan_that_succeeds_late_is_before_one_that_fails_near(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = Known(
        lambda plan: (
            240 - 10 * plan[0, 0] if plan[0, 0] > 1 else None,
            0.04 + 0.01 * abs(plan[0, 0]),
        )
    )
    alone, best, _ = improved(monkeypatch, known, 1)
    assert alone.reached == 0
    assert (best.reached, best.length) == known.best()[:2]


def test_the_middle_and_width_of_a_round_are_of_the_best_sixth_of_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = Known(lambda plan: (100 + 1000 * float(np.square(plan / 5 - 0.2).mean()), 0.0))
    rounds = 30
    _, _, eta = improved(monkeypatch, known, rounds)
    tried = known.plans[1 : 1 + rounds]
    assert not tried[0][0].any()  # the controller's own commands
    middle, width = np.zeros_like(tried[0][0]), WIDTH * eta + np.zeros_like(tried[0][0])
    for plans in tried:
        np.testing.assert_allclose(plans[0], middle, atol=1e-12)
        # Some 23 x 6 or more draws: their root mean square is within four standard errors.
        scaled = (plans[1:] - middle) / width
        assert abs(np.sqrt(np.square(scaled).mean()) - 1) < 4 / np.sqrt(2 * scaled.size)
        kept = plans[
            np.argsort([round(known.outcome(plan)[0] or 0) for plan in plans], kind="stable")[
                : NUM // KEPT
            ]
        ]
        middle = (1 - FOLLOWED) * middle + FOLLOWED * kept.mean(0)
        width = (1 - FOLLOWED) * width + FOLLOWED * np.maximum(kept.std(0), LEAST_WIDTH * eta)
    assert (width >= 0.99 * LEAST_WIDTH * eta).all()


def test_each_try_has_disturbances_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    known = Known(lambda plan: (100.0, 0.0))  # noqa: ARG005
    improved(monkeypatch, known, 3, noise=0.1)
    firsts = [observation[0, BASE_POSITION].tolist() for observation in known.observations]
    assert (
        len(firsts) == 1 + 3 + 2 + 1
    )  # alone, the rounds, two that were found, and the best of all anew
    assert len({tuple(first) for first in firsts}) == len(firsts)
    for observation in known.observations:
        np.testing.assert_array_equal(observation[:, SLICES["target"]], np.tile(TARGET, (NUM, 1)))


def test_an_outcome_is_of_all_tries() -> None:
    nothing, success = np.zeros(0), np.array([True, False, True, True])
    length, nearest = np.array([100, 250, 120, 90]), np.array([0.02, 0.5, 0.03, 0.03])
    found = search._outcome(
        Rollout(nothing, nothing, nothing, nothing, success, success, length, np.ones(4), nearest)
    )
    assert (found.reached, found.length, found.nearest) == (0.75, 140, 0.03)
