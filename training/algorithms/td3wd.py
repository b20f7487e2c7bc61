"""TD3 with demonstrations in its replay: TD3wD of the BATD3 paper, section V-B.

It takes this much of Vecerik et al. 2017. They also draw by priority, mix one-step returns with
longer ones, and keep the demonstrations for ever; here demonstrations are drawn like everything
else, and overwritten once the buffer is full.
"""

from __future__ import annotations

from typing import ClassVar, TypeVar

from training.algorithms.td3 import TD3, TD3Numbers
from training.config.learner import Demonstrated


class TD3wDNumbers(TD3Numbers, Demonstrated):
    """The numbers of TD3wD."""


D = TypeVar("D", bound=TD3wDNumbers)


class TD3wD(TD3[D]):
    """TD3 whose replay buffer begins with the demonstrations."""

    uses_demonstrations: ClassVar[bool] = True
