"""What could be done at all: a search, target by target, for commands that do better than a controller's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from controllers.controller import Controller
from controllers.demonstrations import Rollout, rollout

Array = NDArray[np.float64]

HOLD = 10
"""Actions for which an offset is held; faster ones do little on these arms."""
KEPT = 6
"""One in so many plans is kept from each round."""
FOLLOWED = 0.7
"""How far the distribution moves towards those that are kept, in each round."""
WIDTH, LEAST_WIDTH = 0.4, 0.06
"""Standard deviation of offsets at the start, and the least it comes to, as parts of a servo's eta."""


@dataclass(frozen=True)
class Outcome:
    """How tries at one target went."""

    reached: float
    """Share of the tries that succeed."""
    length: float
    """Mean number of actions; failed tries count in full."""
    nearest: float
    """Median of the least distance from tip to target, in [m]."""

    @property
    def order(self) -> tuple[float, float]:
        """Outcomes sort by this from best to worst: more often reached, then sooner; never reached, then nearer."""
        return (-self.reached, self.length) if self.reached else (0.0, self.nearest)


class Nudged(Controller):
    """A controller whose commands are shifted by a plan of offsets, another one for each copy."""

    def __init__(self, controller: Controller, plans: Array) -> None:
        """Nudge a controller.

        Args:
            controller: whose commands these are.
            plans: shape (num, ceil(actions / HOLD), C), in [m] of set-point.
        """
        self.name = controller.name
        self._controller, self._plans = controller, plans

    def act(self, env: TaskVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
        offset = self._plans[np.arange(env.num_envs), env.actions_taken // HOLD]
        return np.clip(self._controller.act(env, observation, active) + offset, -_eta(env), 0)


def improve(
    controller: Controller,
    env: TaskVectorEnv,
    target: Array,
    rounds: int,
    seed: int,
    wanted: Callable[[Outcome], bool] = lambda outcome: True,  # noqa: ARG005
) -> tuple[Outcome, Outcome]:
    """Search by the cross-entropy method (Rubinstein 1999) for offsets that reach a target more surely, or sooner.

    In every round each copy of the environment tries a plan of its own, drawn about the best so far. A plan that
    reaches the target is better the sooner it does, and one that does not the nearer it comes. The controller keeps
    on closing the loop beneath, and its own commands are a plan of the first round. In the end the best plan, and the
    middle of the last round's, are tried in all copies, and the best of these two and the controller alone is tried
    once more, under disturbances drawn anew: how that goes is a lower bound of what can be done, or under disturbances
    an estimate of one, without the luck of the tries that chose it.

    Args:
        controller: where the search begins.
        env: copies of one robot with autoreset disabled, disturbed or not; of a task that ends with success.
        target: shape (3,), world frame, in [m].
        rounds: how many.
        seed: of plans and disturbances.
        wanted: says from the controller's own outcome whether to search at all.

    Returns:
        How the controller does, and how the best of it and what was found does.
    """
    num, eta = env.num_envs, _eta(env)
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
        # Successes first, by when; then misses, by how near.
        rank = np.where(result.success, result.length, result.nearest)
        order = np.lexsort((rank, ~result.success))
        kept, first = plans[order[: max(1, num // KEPT)]], order[0]
        if (standing := (float(~result.success[first]), float(rank[first]))) < best_rank:
            best, best_rank = plans[first], standing
        mean = mean + FOLLOWED * (kept.mean(0) - mean)
        spread = spread + FOLLOWED * (np.maximum(kept.std(0), LEAST_WIDTH * eta) - spread)
    found = [(_outcome(tried(_everywhere(plan, num))), plan) for plan in (mean, best)]
    _, chosen = min([(alone, np.zeros(mean.shape)), *found], key=lambda option: option[0].order)
    return alone, _outcome(tried(_everywhere(chosen, num)))


def _everywhere(plan: Array, num: int) -> Array:
    """One plan in every copy."""
    return np.broadcast_to(plan, (num, *plan.shape))


def _eta(env: TaskVectorEnv) -> Array:
    """Set-points lie in [-eta, 0], shape (C,), in [m]."""
    return np.array([servo.eta for servo in env.robot.servos])


def _outcome(result: Rollout) -> Outcome:
    return Outcome(
        float(result.success.mean()), float(result.length.mean()), float(np.median(result.nearest))
    )
