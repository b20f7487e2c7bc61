"""TD3 with demonstrations in its replay: TD3wD of the BATD3 paper, section V-B.

That much of Vecerik et al. 2017, who also draw by priority, mix returns over one step with longer ones, and keep the
demonstrations for ever: here they are drawn like everything else, and overwritten once the buffer is full.
"""

from __future__ import annotations

from typing import ClassVar

from training.algorithms.td3 import TD3


class TD3wD(TD3):
    """TD3 whose replay buffer begins with the demonstrations, which are then drawn like everything else."""

    uses_demonstrations: ClassVar[bool] = True
