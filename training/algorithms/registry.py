"""Learning algorithms, one file each; a variant holds only what differs."""

from __future__ import annotations

from training.algorithms.batd3 import BATD3, WithoutAssistance, WithoutPrefill
from training.algorithms.clasp import CLASP
from training.algorithms.drldr import DRLDR
from training.algorithms.her import HER
from training.algorithms.rbl import RBL
from training.algorithms.rlpd import RLPD
from training.algorithms.td3 import TD3
from training.algorithms.td3wd import TD3wD

ALGORITHMS: dict[str, type[TD3]] = {
    "td3": TD3,
    "her": HER,
    "td3wd": TD3wD,
    "rbl": RBL,
    "rlpd": RLPD,
    "drldr": DRLDR,
    "batd3": BATD3,
    "batd3-no-bc": WithoutAssistance,
    "batd3-no-prefill": WithoutPrefill,
    "batd3-no-ensemble": BATD3,  # that is in its numbers; see training.config.run_config
    "clasp": CLASP,
}
"""Off-policy learners by name; "bc" is :class:`BehaviourCloning` alone."""
