"""TD3 + HER: hindsight experience replay (Andrychowicz et al. 2017)."""

from __future__ import annotations

from training.algorithms.td3 import TD3


class HER(TD3):
    """TD3 that also learns from what it did reach: `hindsight` is above zero; see :mod:`training.experience.hindsight`."""
