"""TD3 with demonstrations (Vecerik et al. 2017; TD3wD in the BATD3 paper, section V-B)."""

from __future__ import annotations

from typing import ClassVar

from training.algorithms.td3 import TD3


class TD3wD(TD3):
    """TD3 whose replay buffer begins with the demonstrations, which are then drawn like everything else."""

    uses_demonstrations: ClassVar[bool] = True
