"""Search, target by target, for commands that do better than a controller's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.simulation.contract import State
from controllers.controller import Conditions, Controller, Target
from controllers.rollout import Rollout, rollout

Array = NDArray[np.float64]

HOLD = 10
"""The number of actions for which an offset is held; faster ones do little on these arms."""
KEPT = 6
"""One plan in so many is kept from each round."""
FOLLOWED = 0.7
"""The share of the way that the distribution moves towards the kept plans in each round."""
WIDTH, LEAST_WIDTH = 0.4, 0.06
"""Standard deviation of offsets at the start, and its lower bound, as parts of a servo's eta."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of several tries at one target."""

    reached: float
    """The share of the tries that succeed."""
    length: float
    """The mean number of actions; failed tries count in full."""
    nearest: float
    """The median of the least distance from tip to target, in [m]."""

    @property
    def order(self) -> tuple[float, float]:
        """A key that sorts outcomes from best to worst.

        The share reached counts first, then the length; if no try succeeds, the distance.
        """
        return (-self.reached, self.length) if self.reached else (0.0, self.nearest)


class Nudged(Controller):
    """Adds a plan of offsets to the commands of a controller, another plan for each copy.

    Args:
        controller: the controller whose commands are shifted.
        plans: offsets of the set-points, shape (num, ceil(actions / HOLD), C), in [m].
    """

    def __init__(self, controller: Controller, plans: Array) -> None:
        self.name, self.privileged = controller.name, controller.privileged
        self._controller, self._plans = controller, plans

    def begin(self, conditions: Conditions) -> None:
        self._controller.begin(conditions)
        self._range, self._period = conditions.robot.command_range, conditions.period

    def act(self, state: State, target: Target, time: Array) -> Array:
        actions = np.rint(np.nan_to_num(time) / self._period).astype(np.int64)
        offset = self._plans[np.arange(len(time)), actions // HOLD]
        return np.clip(self._controller.act(state, target, time) + offset, *self._range)


def improve(
    controller: Controller,
    env: TaskVectorEnv,
    target: Array,
    rounds: int,
    seed: int,
    wanted: Callable[[Outcome], bool] = lambda outcome: True,  # noqa: ARG005
) -> tuple[Outcome, Outcome]:
    """Search for offsets that reach a target more surely or sooner.

    The search is the cross-entropy method (Rubinstein 1999). In every round each copy of the
    environment tries a plan of its own, drawn around the best plans of the round before. A plan
    that reaches the target ranks by how soon, and one that does not by how near it comes. The
    controller keeps closing the loop beneath, and its own commands are a plan of the first round.

    In the end the best plan and the mean of the last round's plans are tried in all copies. The
    best of these two and the controller alone is tried once more, under disturbances drawn anew.
    That outcome is free of the luck of the tries that chose it. It is a lower bound of what can be
    done, or under disturbances an estimate of one.

    Args:
        controller: the controller with which the search begins.
        env: copies of one robot with autoreset disabled, at a task that ends with success.
        target: shape (3,), in [m].
        rounds: the number of rounds.
        seed: seeds plans and disturbances.
        wanted: tells from the controller's own outcome whether to search at all.

    Returns:
        The outcome of the controller, and that of the best found.
    """
    num, eta = env.num_envs, np.abs(env.robot.full_commands)
    rng = np.random.default_rng(seed)
    mean = np.zeros((-(-env.max_actions // HOLD), len(eta)))
    spread = np.broadcast_to(WIDTH * eta, mean.shape)

    def tried(plans: Array) -> Rollout:
        options = {"targets": np.tile(target, (num, 1))}
        observation, _ = env.reset(seed=int(rng.integers(2**31)), options=options)
        return rollout(Nudged(controller, plans), env, observation)

    alone = _outcome(tried(np.zeros((num, *mean.shape))))
    if not wanted(alone):
        return alone, alone
    best, best_rank = np.zeros(mean.shape), (2.0, 0.0)
    for _ in range(rounds):
        plans = mean + spread * rng.normal(size=(num, *mean.shape))
        plans[0] = mean
        result = tried(plans)
        # Successes come first, by length; then failures, by distance.
        rank = np.where(result.success, result.length, result.nearest)
        order = np.lexsort((rank, ~result.success))
        kept, first = plans[order[: max(1, num // KEPT)]], order[0]
        if (standing := (float(~result.success[first]), float(rank[first]))) < best_rank:
            best, best_rank = plans[first], standing
        mean = mean + FOLLOWED * (kept.mean(0) - mean)
        spread = spread + FOLLOWED * (np.maximum(kept.std(0), LEAST_WIDTH * eta) - spread)
    found = [(_outcome(tried(_in_every_copy(plan, num))), plan) for plan in (mean, best)]
    _, chosen = min([(alone, np.zeros(mean.shape)), *found], key=lambda option: option[0].order)
    return alone, _outcome(tried(_in_every_copy(chosen, num)))


def _in_every_copy(plan: Array, num: int) -> Array:
    return np.broadcast_to(plan, (num, *plan.shape))


def _outcome(result: Rollout) -> Outcome:
    return Outcome(
        float(result.success.mean()), float(result.length.mean()), float(np.median(result.nearest))
    )
