"""The numbers of the learners that the study changes, and the values it gives them."""

from __future__ import annotations

from training.algorithms.registry import ALGORITHMS, TUNED, differences, own_numbers
from training.config.run_description import Changes

OURS = "clasp"
"""The algorithm of this project."""

# Changes that any learner can have. The tables do not count them as variants of one method.
SYMMETRIC: Changes = (("symmetry", True),)
"""Use the mirror symmetry of the robot."""
PRACTISED: Changes = (("practice", 0.3),)
"""Train on targets up to 0.3 m outside the space."""
FASTER: Changes = (("bfloat16", True),)
"""Multiply matrices in bfloat16."""
GENERAL = (PRACTISED, (*PRACTISED, *SYMMETRIC), SYMMETRIC, FASTER)

OURS_ABLATIONS: tuple[Changes, ...] = (
    (("clone_start", False),),
    (("clone_anchor", 0.0),),
    (("self_imitation", 0.0),),
    (("anchor_updates", 4_000),),
    (("hindsight", 1),),
    (("noise_ladder", True),),
    (("critics", 5),),
)
"""The ablation of CLASP on reaching, one variant an entry."""
HINDSIGHT_ONLY: Changes = (("hindsight", 1), ("self_imitation", 0.0))
"""Hindsight in place of self-imitation. It learns more slowly and misses more targets, but its
episodes end up shorter."""
HARDER_VARIANTS: tuple[Changes, ...] = (
    (("clone_start", False),),
    (("anchor_floor", 0.0), ("clone_anchor", 0.0)),
    (("self_imitation", 0.0),),
    (("noise_ladder", False),),
    PRACTISED,
    SYMMETRIC,
)
"""The ablation of CLASP on capturing and following, one variant an entry."""
RIVAL_VARIANTS: tuple[tuple[str, Changes], ...] = (
    ("rlpd", (("kept_share", 0.25),)),
    ("rlpd", (("critics", 5),)),
    ("rbl", (("clone_start", True),)),
    ("her", (("hindsight", 1),)),
    ("td3wd", (("kept_share", 0.25),)),
)
"""Variants of the other methods: numbers for which their sources give another value, or none."""
MANY_UPDATES: Changes = (("updates_per_step", 4),)
"""Four updates a step, the mark of RLPD. With the same number of updates it then sees a quarter of
the experience."""

_PAPER = ALGORITHMS["batd3"].numbers().model_dump()
PUT_BACK: tuple[Changes, ...] = tuple(
    ((name, _PAPER[name]),)
    for name in sorted(TUNED.keys() - {"updates", "bc_updates", "bc_learning_rate"})
)
"""Each number that the preset `tuned` changes, set back to the paper's value, one an entry."""
_NEEDED = "return_steps", "num_envs", "features", "learning_rate", "layer_norm", "clip_targets"
_RAISED: Changes = tuple((name, TUNED[name]) for name in _NEEDED)
RAISED: tuple[Changes, ...] = (
    _RAISED[:1],
    _RAISED[1:2],
    *(_RAISED[:i] for i in range(2, len(_RAISED) + 1)),
    (_RAISED[0], *_RAISED[2:]),
)
"""Numbers of the preset `tuned` put into the paper's preset: first `return_steps` alone, then
`num_envs` alone, then one more at a time, and last all of them but `num_envs`."""


def ours_for(task: str) -> Changes:
    """Return what CLASP's numbers for a task change in BATD3's."""
    ours, batd3 = (own_numbers(name, "tuned", task) for name in (OURS, "batd3"))
    return differences(ours, batd3)


def task_numbers(task: str) -> Changes:
    """Return the numbers that CLASP has for a kind of task, as far as every method has them."""
    own = ALGORITHMS[OURS].tuned_for.get(task.partition("-")[0], {})
    return tuple((name, value) for name, value in own.items() if name != "anchor_floor")
