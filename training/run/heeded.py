"""Which switches of the learner a run heeds; to turn on one that it does not is a mistake, and is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdcsr.errors import CdcsrError
from training.algorithms.registry import ALGORITHMS
from training.config.run_config import Learner, learner_for

if TYPE_CHECKING:
    from training.config.run_config import Train

_PRACTICE = frozenset(
    {"bfloat16", "clone_start", "hindsight", "keep_successes", "noise_ladder", "step_cost"}
)
"""Switches that say how one practises, which behaviour cloning does not."""


def refuse_unheeded(config: Train) -> None:
    """Make sure that what is switched on in the learner for one method, or for practice, does something in this run.

    Sizes and rates may be there for nothing, so that several methods can be given one learner: behaviour cloning
    does not mind the number of environments.

    Raises:
        CdcsrError: something would do nothing.
    """
    own, unset = learner_for(config.algorithm, config.preset, config.task), Learner()
    for name, found in config.learner.differences(own).items():
        if found != getattr(unset, name) and (why := _unheeded(name, config)):
            raise CdcsrError(
                f"{name} must be {getattr(own, name)} for {config.algorithm}, not {found}: {why}."
            )


def _unheeded(name: str, config: Train) -> str:
    """Why a switch would do nothing, or harm; empty if it would do something, or if this is no switch."""
    readers = [each for each, kind in ALGORITHMS.items() if name in kind.heeds]
    if readers and config.algorithm not in readers:
        return f"it is read by {', '.join(readers)} only"
    if config.algorithm == "bc" and name in _PRACTICE:
        return "it is for methods that practise"
    if (
        name == "clip_targets"
        and config.algorithm != "bc"
        and ALGORITHMS[config.algorithm].reward == "dense"
    ):
        return "its reward is dense, and so are its values"
    if name == "keep_successes" and config.learner.kept_share == 0:
        return "kept_share is 0, so nothing is kept"
    if name == "noise_ladder" and config.learner.num_envs == 1:
        return "num_envs is 1, and the only environment would be without noise"
    return ""
