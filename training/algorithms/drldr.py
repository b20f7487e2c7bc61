"""DRLDR: the backbone on a dense reward, the reference of the BATD3 paper's Fig. 3."""

from __future__ import annotations

from typing import ClassVar

from cdcsr.tasks.task import Reward
from training.algorithms.td3 import TD3


class DRLDR(TD3):
    """TD3 that is paid by the distance to the target, and sees no demonstration."""

    reward: ClassVar[Reward] = "dense"
