"""The search for what could be done: offsets, and what is kept of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.disturbances import Disturbances
from cdcsr.envs import ReachVectorEnv
from controllers.controller import Controller
from controllers.demonstrations import rollout
from controllers.search import HOLD, Nudged, Outcome, improve

Array = NDArray[np.float64]


class Slack(Controller):
    """Lets every cable hang, but for one of each segment, on one side, that pulls."""

    name = "slack"

    def __init__(self, pull: float = 0.0) -> None:
        self.pull = pull

    def act(self, env: ReachVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:  # noqa: ARG002
        commands = np.zeros((env.num_envs, env.robot.num_cables))
        commands[:, 0] = commands[:, 4] = -self.pull
        return commands


def _envs(num: int, steps: int = 250, threshold: float = 0.03, noise: float = 0.0) -> ReachVectorEnv:
    return ReachVectorEnv(
        num, max_steps=steps, threshold=threshold, disturbances=Disturbances(noise), autoreset_mode="Disabled"
    )


def test_offsets_are_added_held_and_clipped_for_each_copy() -> None:
    env = _envs(2)
    env.reset(seed=0)
    plans = np.zeros((2, 25, 8))
    plans[0, 0, 1], plans[1, 1, 2], plans[1, 1, 0] = -0.5, -9.0, 3.0
    nudged = Nudged(Slack(1.0), plans)
    for step in range(2 * HOLD):
        expected = np.zeros((2, 8))
        expected[:, 0] = expected[:, 4] = -1
        if step < HOLD:
            expected[0, 1] = -0.5
        else:
            expected[1, 2], expected[1, 0] = -5.0, 0.0
        commands = nudged.act(env, np.zeros((2, 31)), np.ones(2, bool))
        np.testing.assert_array_equal(commands, expected)
        env.step(commands)
    env.close()


def test_outcomes_sort_by_how_often_then_how_soon_then_how_near() -> None:
    best_first = [
        Outcome(1.0, 90, 0.03), Outcome(1.0, 91, 0.01), Outcome(0.5, 80, 0.02), Outcome(0.0, 250, 0.04),
        Outcome(0.0, 250, 0.05),
    ]  # fmt: skip
    assert sorted(reversed(best_first), key=lambda outcome: outcome.order) == best_first


def test_a_target_that_is_known_to_be_reachable_is_come_near_to() -> None:
    """The target is where a pull on one side brings the tip, which a controller that does nothing never does."""
    env = _envs(24, 60)
    probe = _envs(1, 60, threshold=1e-9)
    observation, _ = probe.reset(seed=0)
    start = observation[0, :3].copy()
    end = rollout(Slack(5.0), probe, observation).observations[0, -1, :3]
    assert np.linalg.norm(end - start) > 0.1
    alone, best = improve(Slack(), env, end, 12, 0)
    assert (alone.reached, alone.length) == (0, 60)
    assert best.nearest < 0.5 * alone.nearest  # whatever the seed: 0.03 to 0.06 of 0.15 m
    assert (best.reached == 1) == (best.nearest <= 0.03)
    assert improve(Slack(), env, end, 1, 0)[1].nearest > best.nearest
    for each in (env, probe):
        each.close()


def test_what_is_found_is_never_worse_and_is_not_sought_where_it_is_not_wanted() -> None:
    env = _envs(6, 20, noise=1.0)
    target = np.array([0.2, 0.1, 2.5])
    alone, best = improve(Slack(), env, target, 1, 0)
    assert best.order <= alone.order
    calls = []

    class Counted(Slack):
        def act(self, env: ReachVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
            calls.append(1)
            return super().act(env, observation, active)

    assert improve(Counted(), env, target, 3, 0, lambda outcome: outcome.reached > 0) == (alone, alone)
    assert len(calls) == 20
    env.close()
