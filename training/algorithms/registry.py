"""The one list of algorithms. A new one touches its own file and this list, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.plots import COLORS, INK, SOFT
from training.algorithms.batd3 import (
    BATD3,
    AssistedNumbers,
    BATD3Numbers,
    WithoutAssistance,
    WithoutAssistanceNumbers,
    WithoutEnsembleNumbers,
    WithoutPrefill,
)
from training.algorithms.clasp import CLASP, CLASPNumbers
from training.algorithms.drldr import DRLDR
from training.algorithms.her import HER, HERNumbers
from training.algorithms.rbl import RBL, RBLNumbers
from training.algorithms.rlpd import RLPD, RLPDNumbers
from training.algorithms.td3 import TD3, BackboneNumbers, TD3Numbers
from training.algorithms.td3wd import TD3wD, TD3wDNumbers
from training.config.learner import Cloning, Network
from training.config.run_description import SCRIPTED, Changes, PresetName, RunDescription


@dataclass(frozen=True)
class Algorithm:
    """An entry of the list."""

    title: str
    """The name as it is written in text."""
    color: str
    """The colour of its curves."""
    numbers: type[Network]
    """The class of its numbers, with the defaults of the preset `paper-reading`."""
    learner: type[TD3[BackboneNumbers]] | None = None
    """The class that updates; None for behaviour cloning, which is supervised."""
    tuned: Mapping[str, object] = field(default_factory=dict)
    """Numbers of its own in the preset `tuned`."""
    tuned_for: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Numbers of its own in the preset `tuned` for a kind of task."""
    ablation: bool = False
    """It is BATD3 without one of its parts."""


BLUE, ORANGE, VIOLET, TEAL, PLUM, GREY, OLIVE, SKY = COLORS

ALGORITHMS: dict[str, Algorithm] = {
    "bc": Algorithm("BC", GREY, Cloning),
    "batd3": Algorithm("BATD3", BLUE, BATD3Numbers, BATD3),
    "clasp": Algorithm(
        "CLASP (ours)",
        ORANGE,
        CLASPNumbers,
        CLASP,
        tuned_for={
            # An episode is twice as long as reaching; an arm that exploration shakes never rests.
            "capture": {"discount": 0.997, "noise_ladder": True},
            # Without a lasting anchor the actor loses the target and never learns to stay on it.
            "follow": {"noise_ladder": True, "anchor_floor": 0.7},
        },
    ),
    "td3wd": Algorithm("TD3wD", VIOLET, TD3wDNumbers, TD3wD),
    "rbl": Algorithm("RBL", PLUM, RBLNumbers, RBL),
    "td3": Algorithm("TD3", OLIVE, TD3Numbers, TD3),
    "her": Algorithm("TD3+HER", SKY, HERNumbers, HER),
    "rlpd": Algorithm(
        "RLPD", TEAL, RLPDNumbers, RLPD, tuned={"updates_per_step": 1, "policy_delay": 2}
    ),
    "drldr": Algorithm("DRLDR", INK, BackboneNumbers, DRLDR),
    "batd3-no-bc": Algorithm(
        "BATD3 without BC assistance",
        ORANGE,
        WithoutAssistanceNumbers,
        WithoutAssistance,
        ablation=True,
    ),
    "batd3-no-prefill": Algorithm(
        "BATD3 without pre-filled data", VIOLET, AssistedNumbers, WithoutPrefill, ablation=True
    ),
    "batd3-no-ensemble": Algorithm(
        "BATD3 without ensemble",
        TEAL,
        WithoutEnsembleNumbers,
        BATD3,
        tuned={"critics": 1, "target_critics": 1},
        ablation=True,
    ),
}
"""By name, in the order of tables."""
_SCRIPTED = {SCRIPTED: ("demonstrator", "#5aa02c"), "nearest": ("nearest demonstration", SOFT)}
"""Titles and colours of controllers that do not learn, the last rows of tables."""

TUNED: Mapping[str, object] = {
    "features": "state+error",
    "layer_norm": True,
    "learning_rate": 6e-4,
    "return_steps": 20,
    "critics": 2,
    "clip_targets": True,
    "saturation_penalty": 0.01,
    "averaged_policy": True,
    "num_envs": 64,
    "exploration_noise": 0.2,
    "noise_hold": 10,
    "updates": 12_000,
    "bc_updates": 3_000,
    "bc_learning_rate": 1e-3,
}
"""Numbers of the preset `tuned`, for every algorithm that has them."""
ON_A_GPU: Mapping[str, object] = {
    "num_envs": 1_024,
    "batch_size": 1_024,
    "updates_per_step": 2,
    "capacity": 2_000_000,
}
"""The numbers that the preset `gpu` changes in `tuned`."""


def find_algorithm(name: str) -> Algorithm:
    """Return the algorithm of a name.

    Raises:
        CdcsrError: there is none.
    """
    if name not in ALGORITHMS:
        raise CdcsrError(unknown_choice("algorithm", name, ALGORITHMS))
    return ALGORITHMS[name]


def own_numbers(name: str, preset: PresetName, task: str = "reach") -> Network:
    """Return an algorithm's own numbers in a preset, for a task.

    Raises:
        CdcsrError: there is no such algorithm.
    """
    entry = find_algorithm(name)
    if preset == "paper-reading":
        return entry.numbers()
    kind = task.partition("-")[0]
    numbers = {**TUNED, **entry.tuned, **entry.tuned_for.get(kind, {})}
    numbers |= ON_A_GPU if preset == "gpu" else {}
    known = entry.numbers.model_fields
    return entry.numbers().changed(**{k: v for k, v in numbers.items() if k in known})


def numbers_of(run: RunDescription) -> Network:
    """Return the numbers of a run's learner.

    Raises:
        CdcsrError: the algorithm has no such number, or a number is out of bounds.
    """
    own = own_numbers(run.algorithm, run.preset, run.task)
    length = {"updates": run.updates} if run.updates and hasattr(own, "updates") else {}
    return own.changed(**length, **dict(run.changes))


def differences(one: Network, other: Network) -> Changes:
    """Return the numbers of `one` that are others in `other`, or missing there, by name."""
    there = other.model_dump()
    return tuple(
        (name, value)
        for name, value in sorted(one.model_dump().items())
        if name in there and value != there[name]
    )


def algorithm_title(name: str) -> str:
    """Return the title of an algorithm or scripted controller; an unknown name is its own."""
    if name in ALGORITHMS:
        return ALGORITHMS[name].title
    return _SCRIPTED.get(name, (name, SOFT))[0]


def algorithm_color(name: str) -> str:
    """Return the colour of an algorithm or scripted controller."""
    return ALGORITHMS[name].color if name in ALGORITHMS else _SCRIPTED.get(name, (name, SOFT))[1]


def algorithm_order(name: str) -> int:
    """Return the place of an algorithm or scripted controller in tables."""
    names = [*ALGORITHMS, *_SCRIPTED]
    return names.index(name) if name in names else len(names)
