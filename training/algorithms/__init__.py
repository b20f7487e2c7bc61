"""Learning algorithms, one file each; a variant holds only what differs."""

from __future__ import annotations

from training.algorithms.batd3 import BATD3
from training.algorithms.bc import BehaviourCloning
from training.algorithms.td3 import TD3

ALGORITHMS: dict[str, type[TD3]] = {"td3": TD3, "batd3": BATD3}
"""Off-policy learners by name; "bc" is :class:`BehaviourCloning` alone."""

__all__ = ["ALGORITHMS", "BATD3", "TD3", "BehaviourCloning"]
