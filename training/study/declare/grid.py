"""The experiments of the study: the runs of each, and the evaluations it needs of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.tasks.starts import StartName
from training.algorithms.registry import ALGORITHMS
from training.config.run_description import NEAREST, SCRIPTED, RunDescription
from training.study.declare.budgets import Budget
from training.study.declare.experiment import Cell, Experiment, trained, untrained
from training.study.declare.learner_changes import (
    FASTER,
    HARDER_VARIANTS,
    HINDSIGHT_ONLY,
    MANY_UPDATES,
    OURS,
    OURS_ABLATIONS,
    PRACTISED,
    PUT_BACK,
    RAISED,
    RIVAL_VARIANTS,
    SYMMETRIC,
    ours_for,
    task_numbers,
)

SPACES = ("spatter", "anchor", "floating")
AROUND = "workspace"
"""The whole workspace of the demonstrator. As an evaluation: the policy is tested there, wherever
it was trained."""
_FIRST = ("batd3", "bc", OURS, "td3wd", "rlpd", "rbl", "drldr")
METHODS = (
    *_FIRST,
    *(name for name, entry in ALGORITHMS.items() if not (entry.ablation or name in _FIRST)),
)
"""The methods of Table II, in the order in which they are run: those compared most come first."""
PRACTISING = ("batd3", OURS)
TASK_METHODS = ("batd3", "bc", OURS, "td3wd", "rlpd")
ABLATIONS = ("batd3", *(name for name, entry in ALGORITHMS.items() if entry.ablation))
COUNTS = (3, 5, 20)
"""Numbers of demonstrations that are tried beside the usual 10."""
TASKS = (("reach", AROUND), ("capture", "anchor"), ("precise", "anchor"), ("quiet", "anchor"))
"""Tasks and spaces that the paper does not have."""
HARDER = ("capture", "follow-random")
"""Tasks in which the tip must stay on the target. In Anchor Space."""
MOVING = ("capture-drift", "capture-tumble")
"""Tasks in which the target moves. In Anchor Space."""
TRANSFERRED: tuple[tuple[str, str, str, str, float, float, StartName], ...] = (
    (OURS, "mujoco", "spatter", "reach", 0.0, 0.0, "still"),
    ("bc", "mujoco", "spatter", "reach", 0.0, 0.0, "still"),
    (OURS, "mujoco", "spatter", "reach", 1.0, 0.0, "still"),
    (OURS, "pybullet", "spatter", "reach", 0.0, 0.0, "still"),
    ("batd3", "mujoco", "spatter", "reach", 0.0, 0.0, "still"),
    (OURS, "mujoco-stock", "spatter", "reach", 0.0, 0.0, "still"),
    (OURS, "mujoco+mujoco-stock", "spatter", "reach", 0.0, 0.0, "still"),
    ("bc", "mujoco", "anchor", "capture", 0.0, 0.0, "still"),
    (OURS, "mujoco", "anchor", "capture", 0.0, 0.0, "still"),
    (OURS, "mujoco+mujoco-stock", "anchor", "capture", 0.0, 0.0, "still"),
    (OURS, "mujoco", "spatter", "reach", 0.0, 0.0, "anywhere"),
    (OURS, "mujoco", "spatter", "reach", 0.0, 1.0, "still"),
)
"""The recipes whose transfer is measured: algorithm, engine of training, space, task, scale of
domain randomization, that of soft cables, start."""


EXPERIMENTS = {
    "table2": Experiment(
        "Table II and Fig. 3: every method in the three spaces.",
        [
            untrained(SCRIPTED),
            untrained(NEAREST),
            *(trained(name, space) for space, name in product(SPACES, METHODS)),
        ],
    ),
    "fig4": Experiment(
        "Fig. 4: BATD3 without each of its parts.",
        [trained(name, space) for space, name in product(SPACES, ABLATIONS)],
    ),
    "fig5": Experiment(
        "Fig. 5: more and fewer demonstrations, in Anchor Space.",
        [
            trained(name, "anchor", demonstrations=count)
            for count, name in product((10, *COUNTS), ("batd3", "bc", OURS, "td3wd"))
        ],
    ),
    "table3": Experiment(
        "Table III: trained in one space, tested in the others and in the whole workspace.",
        [trained(name, space, "nominal", AROUND) for space, name in product(SPACES, PRACTISING)],
    ),
    "table4": Experiment(
        "Table IV: noise on commands and on the base's position, and lost packets.",
        [
            untrained(SCRIPTED, "nominal", "disturbances"),
            *(
                trained(name, space, "nominal", "disturbances")
                for space, name in product(SPACES, (*PRACTISING, "bc"))
            ),
        ],
    ),
    "fig6": Experiment(
        "Fig. 6: following a target that moves, and how far the base moves meanwhile.",
        [
            untrained(SCRIPTED, "follow"),
            untrained(SCRIPTED, "follow", task="capture"),
            untrained(SCRIPTED, "nominal", "follow", task="follow-random"),
            *(
                trained(name, space, "nominal", "follow", task=task)
                for (task, space), name in product(
                    (
                        ("follow-random", "anchor"),
                        ("reach", "spatter"),
                        ("reach", "anchor"),
                        ("capture", "anchor"),
                    ),
                    (*PRACTISING, "bc"),
                )
            ),
        ],
    ),
    "transfer": Experiment(
        "Five seeds, each with demonstrations of its own: trained in one engine, tested in all.",
        [
            trained(
                name,
                space,
                "engines",
                backend=backend,
                task=task,
                randomize=scale,
                soften=soften,
                start=start,
                own_demonstrations=True,
            )
            for name, backend, space, task, scale, soften, start in TRANSFERRED
        ],
    ),
    "more-seeds": Experiment(
        "CLASP capturing in MuJoCo, with five seeds that the other experiments do not have.",
        [trained(OURS, "anchor", task="capture", more_seeds=5)],
    ),
    "plants": Experiment(
        "A plant that differs from the description, with and without domain randomization.",
        [
            untrained(SCRIPTED, "plants"),
            *(
                trained(name, "spatter", "nominal", "plants", randomize=scale)
                for name, scale in (
                    *product(PRACTISING, (0.0, 1.0)),
                    ("bc", 0.0),  # cloning has no episodes to randomize
                )
            ),
        ],
    ),
    "tasks": Experiment(
        "Beyond the paper: the whole workspace, coming to rest on the target, a finer threshold, a"
        " still base.",
        [
            *(untrained(SCRIPTED, task=task, space=space) for task, space in TASKS),
            *(
                trained(name, space, task=task)
                for name, (task, space) in product((*TASK_METHODS, "rbl"), TASKS)
            ),
        ],
    ),
    "symmetry": Experiment(
        "With and without mirror symmetry: in the whole workspace, and trained in Spatter or"
        " Anchor.",
        [
            cell
            for changes in (SYMMETRIC, ())
            for cell in (
                *(
                    trained(name, AROUND, changes=changes)
                    for name in (OURS, "batd3", "bc", "td3wd")
                ),
                *(
                    trained(name, space, "nominal", AROUND, changes=changes)
                    for space, name in product(("spatter", "anchor"), (OURS, "batd3"))
                ),
            )
        ],
    ),
    "practice": Experiment(
        "Wider targets in training, with and without mirror symmetry, and neither: in Anchor or"
        " Floating.",
        [
            trained(name, space, "nominal", AROUND, changes=changes)
            for changes, space, name in product(
                (PRACTISED, (*PRACTISED, *SYMMETRIC), ()), ("anchor", "floating"), (OURS, "batd3")
            )
        ],
    ),
    "ours": Experiment(
        "CLASP without each of its parts, and BATD3 with CLASP's numbers.",
        [
            *(trained(OURS, "spatter", changes=changes) for changes in ((), *OURS_ABLATIONS)),
            trained("batd3", "spatter", changes=ours_for("reach")),
        ],
    ),
    "rivals": Experiment(
        "Variants of the other methods; RLPD with four updates a step, also four times as long.",
        [
            *(
                trained(name, "spatter", changes=changes)
                for name, variant in RIVAL_VARIANTS
                for changes in ((), variant)
            ),
            *(trained("rlpd", space, changes=MANY_UPDATES) for space in SPACES),
            trained("rlpd", "spatter", changes=MANY_UPDATES, length=4),
        ],
    ),
    "harder": Experiment(
        "Capturing and following: variants of CLASP, and other methods with CLASP's numbers.",
        [
            trained(name, "anchor", task=task, changes=changes)
            for task in HARDER
            for name, changes in (
                (OURS, ()),
                ("batd3", ours_for(task)),
                ("batd3", tuple(one for one in ours_for(task) if one[0] != "self_imitation")),
                ("batd3", task_numbers(task)),
                ("td3wd", task_numbers(task)),
                ("rbl", task_numbers(task)),
                *((OURS, changes) for changes in HARDER_VARIANTS),
            )
        ],
    ),
    "moving": Experiment(
        "Capturing a target that drifts or tumbles; CLASP also with four times the updates.",
        [
            *(untrained(SCRIPTED, task=task) for task in MOVING),
            *(
                cell
                for task in MOVING
                for cell in (
                    *(trained(name, "anchor", task=task) for name in TASK_METHODS),
                    trained(OURS, "anchor", task=task, length=4),
                )
            ),
        ],
    ),
    "bfloat16": Experiment(
        "Matrix products in bfloat16 and in float32: BATD3 and CLASP in the three spaces.",
        [
            trained(name, space, changes=changes)
            for space, name, changes in product(SPACES, PRACTISING, (FASTER, ()))
        ],
    ),
    "longer": Experiment(
        "Four times the updates: BATD3 and CLASP in Spatter, CLASP with wider targets in each"
        " space.",
        [
            *(
                trained(name, "spatter", "nominal", "disturbances", length=4, changes=changes)
                for name, changes in ((OURS, HINDSIGHT_ONLY), ("batd3", ()), (OURS, ()))
            ),
            *(
                trained(OURS, space, "nominal", "disturbances", AROUND, length=4, changes=changes)
                for changes, space in (
                    *((PRACTISED, space) for space in SPACES),
                    ((*PRACTISED, *SYMMETRIC), "anchor"),
                )
            ),
        ],
    ),
    "preset": Experiment(
        "The preset `tuned` with one number put back to the paper's: BATD3 in Spatter, TD3 in"
        " Anchor.",
        [
            trained(name, space, changes=changes)
            for changes, (name, space) in product(
                ((), *PUT_BACK), (("batd3", "spatter"), ("td3", "anchor"))
            )
        ],
    ),
    "paper-preset": Experiment(
        "BATD3 and BC with the paper's numbers, as this project reads them.",
        [
            trained(name, space, preset="paper-reading")
            for space, name in product(SPACES, ("batd3", "bc"))
        ],
    ),
    "raised": Experiment(
        "The paper's preset with one number of `tuned` after another, for BATD3 in Spatter.",
        [
            trained("batd3", "spatter", preset="paper-reading", changes=changes)
            for changes in ((), *RAISED)
        ],
    ),
}
"""All experiments by name, the most telling first."""


def collect(
    names: Sequence[str], budget: Budget
) -> dict[str, tuple[RunDescription, tuple[str, ...]]]:
    """Return the runs of some experiments by name, each once, with all its evaluations.

    All runs of seed 0 come first, then those of seed 1, and so on: a study that is stopped early
    has every cell from fewer seeds.

    Raises:
        CdcsrError: there is no such experiment.
    """
    runs: dict[str, tuple[RunDescription, tuple[str, ...]]] = {}
    for experiment in names:
        if experiment not in EXPERIMENTS:
            raise CdcsrError(unknown_choice("experiment", experiment, EXPERIMENTS))
        for cell in EXPERIMENTS[experiment].cells:
            updates = cell.length * budget.length(cell.spec.preset)
            for seed in _seeds(cell, budget):
                own = seed if cell.own_demonstrations else cell.spec.demonstration_seed
                spec = replace(cell.spec, seed=seed, updates=updates, demonstration_seed=own)
                _, before = runs.get(spec.name, (spec, ()))
                runs[spec.name] = spec, tuple(dict.fromkeys((*before, *cell.evaluations)))
    return dict(sorted(runs.items(), key=lambda item: item[1][0].seed))


def _seeds(cell: Cell, budget: Budget) -> range:
    """Return the seeds of a cell. Demonstrations of seed 0 belong to all other runs."""
    if cell.own_demonstrations:
        return range(1, budget.own_seeds + 1)
    if cell.more_seeds:
        return range(budget.seeds, budget.seeds + cell.more_seeds)
    return range(budget.seeds if cell.spec.trains else 1)


def expected(budget: Budget) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the names of all runs of each experiment, with the evaluations it needs of them."""
    return {
        name: {run: evaluations for run, (_, evaluations) in collect([name], budget).items()}
        for name in EXPERIMENTS
    }
