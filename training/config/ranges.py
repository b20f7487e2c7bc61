"""Numbers of a training run that cannot be, refused before anything is made."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

from cdcsr.errors import CdcsrError

if TYPE_CHECKING:
    from training.config.run_config import Train

EVALUATION_SEEDS = {10_000: "held-out targets", 20_000: "validation targets"}
"""Whose targets nothing may learn from; see :mod:`training.measure.evaluation`."""
_COUNTS = (
    "batch_size",
    "return_steps",
    "policy_delay",
    "num_envs",
    "noise_hold",
    "updates",
    "bc_updates",
    "anchor_updates",
    "updates_per_step",
    "bc_rollouts",
)
_POSITIVE = ("learning_rate", "bc_learning_rate")
_NOT_NEGATIVE = (
    "clone_anchor",
    "anchor_floor",
    "self_imitation",
    "step_cost",
    "target_noise",
    "noise_clip",
    "softmax_temperature",
    "saturation_penalty",
    "exploration_noise",
    "hindsight",
)


def refuse_out_of_range(config: Train) -> None:
    """Make sure that each number of a run is one that it can have.

    Raises:
        CdcsrError: one is not.
    """
    learner = config.learner
    for one in fields(learner):
        value = getattr(learner, one.name)
        if isinstance(value, float) and not math.isfinite(value) and one.name != "practice":
            raise CdcsrError(f"{one.name} must be finite, not {value}.")
    if config.randomize:
        from cdcsr.simulation.randomization import (
            check_scale,  # it knows robots, which `cdcsr --help` need not wait for
        )

        check_scale(config.randomize)
    if not 1 <= learner.target_critics <= learner.critics:
        raise CdcsrError(
            f"target_critics must be between 1 and critics ({learner.critics}), not {learner.target_critics}."
        )
    counts = {name: getattr(learner, name) for name in _COUNTS}
    counts |= {
        "num_demonstrations": config.num_demonstrations,
        "evaluate_episodes": config.evaluate_episodes,
    }
    for name, value in counts.items():
        if value < 1:
            raise CdcsrError(f"{name} must be at least 1, not {value}.")
    if not learner.hidden or min(learner.hidden) < 1:
        raise CdcsrError(
            f"hidden must be the width of at least one layer, each at least 1, not {learner.hidden}."
        )
    if config.seed < 0:
        raise CdcsrError(f"seed must not be negative, found {config.seed}.")
    if config.seed >= 2**63:
        raise CdcsrError(f"seed must be below 2^63, found {config.seed}.")
    if config.seed in EVALUATION_SEEDS:
        raise CdcsrError(
            f"seed {config.seed} is that of the {EVALUATION_SEEDS[config.seed]}; give another."
        )
    if config.evaluate_every < 0:
        raise CdcsrError(f"evaluate_every must not be negative, found {config.evaluate_every}.")
    if config.stop_after is not None and not config.stop_after >= 0:
        raise CdcsrError(f"stop_after must be a number of minutes, not {config.stop_after}.")
    for name in _POSITIVE:
        if not getattr(learner, name) > 0:
            raise CdcsrError(f"{name} must be positive, not {getattr(learner, name)}.")
    for name in _NOT_NEGATIVE:
        if getattr(learner, name) < 0:
            raise CdcsrError(f"{name} must not be negative, found {getattr(learner, name)}.")
    for name, found in (("practice", learner.practice), ("randomize", config.randomize)):
        if found and config.algorithm == "bc":
            raise CdcsrError(f"{name} must be 0 for bc, which does not practise, not {found}.")
    if not 0 <= learner.practice < math.inf:
        raise CdcsrError(f"practice must be a distance in [m], or 0, not {learner.practice}.")
    if not 0 <= learner.kept_share < 1:
        raise CdcsrError(f"kept_share must lie in [0, 1), not {learner.kept_share}.")
    if not 0 <= learner.final_learning_rate <= 1:
        raise CdcsrError(
            f"final_learning_rate must lie in [0, 1], not {learner.final_learning_rate}."
        )
    for name in ("discount", "soft_update"):
        if not 0 < getattr(learner, name) <= 1:
            raise CdcsrError(f"{name} must lie in (0, 1], not {getattr(learner, name)}.")
