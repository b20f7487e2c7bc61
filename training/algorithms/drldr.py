"""DRLDR: the backbone on a dense reward, the reference of the BATD3 paper's Fig. 3."""

from __future__ import annotations

from typing import ClassVar

from cdcsr.tasks.task import Reward
from training.algorithms.td3 import TD3, BackboneNumbers


class DRLDR(TD3[BackboneNumbers]):
    """TD3 whose reward is minus the distance to the target; it sees no demonstration."""

    reward: ClassVar[Reward] = "dense"
