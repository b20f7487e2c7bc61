"""TD3 + HER: hindsight experience replay (Andrychowicz et al. 2017)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from training.algorithms.td3 import TD3, TD3Numbers


class HERNumbers(TD3Numbers):
    """The numbers of HER."""

    hindsight: Annotated[int, Field(ge=0, le=1_000)] = 4
    """Copies of each collected episode that are stored with a target that the tip did reach."""


class HER(TD3[HERNumbers]):
    """TD3 that also learns from targets it did reach; see :mod:`training.experience.hindsight`."""
