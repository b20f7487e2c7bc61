"""RLPD: reinforcement learning with prior data (Ball et al. 2023), on TD3.

Half of every batch comes from the demonstrations, critics have LayerNorm, and each step has many
updates. The length of a run is in updates, so many updates a step mean little experience: in the
preset `tuned` RLPD has one update a step, as all methods have.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from training.algorithms.td3wd import TD3wD, TD3wDNumbers
from training.config.learner import Count


class RLPDNumbers(TD3wDNumbers):
    """The numbers of RLPD."""

    kept_share: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Share of each batch that comes from the demonstration buffer."""
    layer_norm: bool = True
    """Use LayerNorm before each hidden activation of the critics."""
    updates_per_step: Count = 20
    """Updates after each step of the environments."""
    policy_delay: Count = 20
    """Updates of the critics for each update of the actor."""


class RLPD(TD3wD[RLPDNumbers]):
    """TD3wD with a demonstration buffer; what it does differently is in its numbers."""
