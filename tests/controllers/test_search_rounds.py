"""The rounds of the search, compared with sums over the plans that it tries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.tasks.observation import BASE_POSITION, SLICES
from controllers import search
from controllers.rollout import Rollout
from controllers.search import FOLLOWED, KEPT, LEAST_WIDTH, WIDTH, Nudged, Outcome, improve
from tests.support.controllers import Still

Array = NDArray[np.float64]
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
