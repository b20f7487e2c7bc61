"""What the study changes in learners: numbers and the values they get, for our method, for others, for all."""

from __future__ import annotations

from typing import Any

from training.config.run_config import PRESETS, TASK_OWN, learner_for

Switches = tuple[tuple[str, Any], ...]
"""Numbers of a learner with their values."""

OURS = "clasp"
"""The name of our own method."""
OURS_SWITCHES: tuple[Switches, ...] = (
    (("clone_start", False),),
    (("clone_anchor", 0.0),),
    (("self_imitation", 0.0),),
    (("anchor_updates", 4_000),),
    (("hindsight", 1),),
    (("discount", 1.0), ("step_cost", 0.004)),
    (("final_learning_rate", 0.1),),
    (("kept_share", 0.25), ("keep_successes", True)),
    (("noise_ladder", True),),
    (("clone_anchor", 2.0), ("scaled_values", True)),
    (("critics", 5),),
)
"""What the ablation of our method changes in its learner, one change an entry."""
UNHURRIED: Switches = (("hindsight", 1), ("self_imitation", 0.0))
"""Hindsight in place of self-imitation: slower at first, it ends in shorter episodes, though it misses more targets."""
SYMMETRIC: Switches = (("symmetry", True),)
"""The robot's mirror images made use of: for every method."""
PRACTISED: Switches = (("practice", 0.3),)
"""Practice past the space of training: for every method that practises."""
FASTER: Switches = (("bfloat16", True),)
"""Products of updates in bfloat16: for every method that practises."""
GENERAL = (PRACTISED, (*PRACTISED, *SYMMETRIC), SYMMETRIC, FASTER)
"""What is for any method, and no variant of ours."""
_TUNED = PRESETS["tuned"].differences(PRESETS["paper"]).keys() - {
    "updates",
    "bc_updates",
    "bc_learning_rate",
}
PUT_BACK = tuple(((name, getattr(PRESETS["paper"], name)),) for name in sorted(_TUNED))
"""What the preset `tuned` changes for practice, put back to the paper's, one number an entry."""
_NEEDED = "return_steps", "num_envs", "features", "learning_rate", "layer_norm", "clip_targets"
_RAISED = tuple((name, getattr(PRESETS["tuned"], name)) for name in _NEEDED)
RAISED = (
    _RAISED[:1],
    _RAISED[1:2],
    *(_RAISED[:i] for i in range(2, len(_RAISED) + 1)),
    (_RAISED[0], *_RAISED[2:]),
)
"""What is taken over from it into the paper's preset: what BATD3 needs most, alone, then one more at a time; last all
with the paper's one environment, and so with its experience."""
RIVALS_SWITCHES: tuple[tuple[str, Switches], ...] = (
    ("rlpd", (("kept_share", 0.25),)),
    ("rlpd", (("critics", 5),)),
    ("rbl", (("clone_start", True),)),
    ("her", (("hindsight", 1),)),
    ("td3wd", (("kept_share", 0.25),)),
)
"""What is changed in the learners of the methods that ours is compared with: numbers that their sources have otherwise,
or leave open."""
MANY_UPDATES: Switches = (("updates_per_step", 4),)
"""What RLPD is known for: in as many updates, a quarter of the experience."""
HARDER_SWITCHES: tuple[Switches, ...] = (
    (("clone_start", False),),
    (("anchor_floor", 0.0), ("clone_anchor", 0.0)),
    (("self_imitation", 0.0),),
    (("noise_ladder", False),),
    PRACTISED,
    SYMMETRIC,
)
"""What is changed there in our method, one change an entry."""
CHOICES = ("hard", "scaled")
"""Other ways for BATD3's targets to choose between clone and policy."""


def lent(task: str) -> Switches:
    """Our numbers for a task, where they are not BATD3's."""
    return tuple(
        learner_for(OURS, "tuned", task).differences(learner_for("batd3", "tuned", task)).items()
    )


def lent_for_the_task(task: str) -> Switches:
    """Of our numbers those that we have for the task, and any method can have."""
    own = TASK_OWN.get((OURS, task.partition("-")[0]), {})
    return tuple((name, value) for name, value in own.items() if name != "anchor_floor")
