"""Which switches of the learner a run heeds; to turn on one that it does not is a mistake, and is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdcsr.errors import CdcsrError
from training.algorithms import ALGORITHMS
from training.config import CLONES, Learner, learner_for

if TYPE_CHECKING:
    from training.config import Train


def refuse_unheeded(config: Train) -> None:
    """Make sure that whatever is switched on in the learner, or chosen for one method, does something in this run.

    Sizes and rates may be there for nothing, so that several methods can be given one learner: behaviour cloning
    does not mind the number of environments.

    Raises:
        CdcsrError: something would do nothing.
    """
    own, unset = learner_for(config.algorithm, config.preset, config.task), Learner()
    for name, found in config.learner.differences(own).items():
        if found != getattr(unset, name) and (why := _unheeded(name, config)):
            raise CdcsrError(f"{name} must be {getattr(own, name)} for {config.algorithm}, not {found}: {why}.")


def _unheeded(name: str, config: Train) -> str:
    """Why something would do nothing; empty if it would do something, or is no switch."""
    readers = [each for each, kind in ALGORITHMS.items() if name in kind.heeds]
    if readers and config.algorithm not in readers:
        return f"it is read by {', '.join(readers)} only"
    if config.algorithm == "bc" and not getattr(Learner(), name) and name not in CLONES:
        return "it is for methods that practise"
    if name == "keep_successes" and config.learner.kept_share == 0:
        return "kept_share is 0, so nothing is kept"
    return ""
