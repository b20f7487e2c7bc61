"""The declared experiments: which runs, which of their evaluations, most telling ones first."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.simulation.engines import backend_names
from training.config.run_config import PresetName
from training.study.declare.run_spec import SCRIPTED, RunSpec
from training.study.declare.switches import (
    CHOICES,
    FASTER,
    HARDER_SWITCHES,
    MANY_UPDATES,
    OURS,
    OURS_SWITCHES,
    PRACTISED,
    PUT_BACK,
    RAISED,
    RIVALS_SWITCHES,
    SYMMETRIC,
    UNHURRIED,
    lent,
    lent_for_the_task,
)


@dataclass(frozen=True)
class Budget:
    """How much of everything, the same for every method."""

    name: str
    seeds: int
    updates: int
    """Of a run with the preset `tuned`."""
    paper_updates: int
    """Of a run with the preset `paper`."""
    episodes: int
    """Of each cell of an evaluation."""
    evaluate_every: int
    """Updates between points of a learning curve, and checkpoints."""
    validation_episodes: int
    """Of each of those points."""

    def length(self, preset: PresetName) -> int:
        """Updates of a run."""
        return self.paper_updates if preset == "paper" else self.updates


BUDGETS = {
    budget.name: budget
    for budget in (
        Budget("quick", 1, 1_500, 1_500, 20, 500, 20),
        Budget("standard", 3, 6_000, 20_000, 100, 750, 100),
        Budget("paper", 5, 12_000, 100_000, 100, 1_000, 100),
    )
}

SPACES = ("spatter", "anchor", "floating")
AROUND = "workspace"
"""The space of all that the demonstrator reaches; also the evaluation of a policy there that was trained elsewhere."""
METHODS = ("batd3", "bc", "clasp", "td3wd", "rlpd", "rbl", "drldr", "td3", "her")
"""All of them, those that are compared most first."""
HARDER = ("capture", "follow-random")
"""Tasks past a fly-by, where methods differ most; in Anchor."""
MOVING = ("capture-drift", "capture-tumble")
"""Capture of a target that is not at rest; in Anchor."""
ABLATIONS = ("batd3", "batd3-no-bc", "batd3-no-prefill", "batd3-no-ensemble")
COUNTS = (3, 5, 20)
"""Numbers of demonstrations, besides 10."""
TASKS = (("reach", AROUND), ("capture", "anchor"), ("precise", "anchor"), ("quiet", "anchor"))
"""What goes beyond the paper: (task, space)."""
TASK_METHODS = ("batd3", "bc", OURS, "td3wd", "rlpd")

Cell = tuple[RunSpec, tuple[str, ...]]
"""A run, and the evaluations of it that an experiment needs."""
Experiment = Callable[[Budget], Iterator[Cell]]
"""The first line of its docstring says what it is."""


def table2(budget: Budget) -> Iterator[Cell]:
    """Table II and Fig. 3: every method in the three spaces."""
    yield _scripted(), ("nominal",)
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in METHODS:
                yield _spec(budget, algorithm, space, seed), ("nominal",)


def fig4(budget: Budget) -> Iterator[Cell]:
    """Fig. 4: BATD3 without each of its parts."""
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in ABLATIONS:
                yield _spec(budget, algorithm, space, seed), ("nominal",)


def fig5(budget: Budget) -> Iterator[Cell]:
    """Fig. 5: more and fewer demonstrations, in Anchor Space."""
    for seed in range(budget.seeds):
        for count in (10, *COUNTS):
            for algorithm in ("batd3", "bc", OURS, "td3wd"):
                yield _spec(budget, algorithm, "anchor", seed, demonstrations=count), ("nominal",)


def table3(budget: Budget) -> Iterator[Cell]:
    """Table III: trained in one space, tested in the others, and all around the arm."""
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in ("batd3", OURS):
                yield _spec(budget, algorithm, space, seed), ("nominal", AROUND)


def table4(budget: Budget) -> Iterator[Cell]:
    """Table IV: noise on commands and on the base's position, and lost packets."""
    yield _scripted(), ("nominal", "disturbances")
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in ("batd3", OURS, "bc"):
                yield _spec(budget, algorithm, space, seed), ("nominal", "disturbances")


def fig6(budget: Budget) -> Iterator[Cell]:
    """Fig. 6: following a target that moves, and what the base does meanwhile."""
    yield _scripted(), ("follow",)
    yield _scripted(task="capture"), ("follow",)
    yield _scripted(task="follow-random"), ("nominal", "follow")
    for seed in range(budget.seeds):
        for task, space in (
            ("follow-random", "anchor"),
            ("reach", "spatter"),
            ("reach", "anchor"),
            ("capture", "anchor"),
        ):
            for algorithm in ("batd3", OURS, "bc"):
                yield _spec(budget, algorithm, space, seed, task=task), ("nominal", "follow")


def transfer(budget: Budget) -> Iterator[Cell]:
    """Every method trained in each engine, tested in both."""
    yield _scripted(), ("nominal",)
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in METHODS:
                for backend in backend_names():
                    yield _spec(budget, algorithm, space, seed, backend=backend), ("nominal",)
        for task, space in TASKS:
            for algorithm in TASK_METHODS:
                for backend in backend_names():
                    yield (
                        _spec(budget, algorithm, space, seed, task=task, backend=backend),
                        ("nominal",),
                    )


def plants(budget: Budget) -> Iterator[Cell]:
    """A plant that is not as described, with and without randomization in training."""
    yield _scripted(), ("plants",)
    for seed in range(budget.seeds):
        for algorithm in ("batd3", OURS, "bc"):
            for randomize in (
                (0.0,) if algorithm == "bc" else (0.0, 1.0)
            ):  # a clone does not practise
                yield (
                    _spec(budget, algorithm, "spatter", seed, randomize=randomize),
                    ("nominal", "plants"),
                )


def tasks(budget: Budget) -> Iterator[Cell]:
    """Beyond the paper: all around the arm, coming to rest on the target, a finer threshold, a still base."""
    for task, space in TASKS:
        yield _scripted(task=task, space=space), ("nominal",)
    for seed in range(budget.seeds):
        for algorithm in (
            *TASK_METHODS,
            "rbl",
        ):  # the rival that comes closest to ours in the paper's spaces
            for task, space in TASKS:
                yield _spec(budget, algorithm, space, seed, task=task), ("nominal",)


def paper_preset(budget: Budget) -> Iterator[Cell]:
    """BATD3 and BC with the paper's own numbers."""
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in ("batd3", "bc"):
                yield _spec(budget, algorithm, space, seed, preset="paper"), ("nominal",)


def symmetry(budget: Budget) -> Iterator[Cell]:
    """The robot's mirror images made use of, and not: all around the arm, and trained in Spatter or Anchor."""
    for seed in range(budget.seeds):
        for switches in (SYMMETRIC, ()):
            for algorithm in (OURS, "batd3", "bc", "td3wd"):
                yield _spec(budget, algorithm, AROUND, seed, switches=switches), ("nominal",)
            for space in ("spatter", "anchor"):
                for algorithm in (OURS, "batd3"):
                    yield (
                        _spec(budget, algorithm, space, seed, switches=switches),
                        ("nominal", AROUND),
                    )


def practice(budget: Budget) -> Iterator[Cell]:
    """Practice past the space of training, with symmetry and without, and not: trained in Anchor or Floating."""
    for seed in range(budget.seeds):
        for switches in (PRACTISED, (*PRACTISED, *SYMMETRIC), ()):
            for space in ("anchor", "floating"):
                for algorithm in (OURS, "batd3"):
                    yield (
                        _spec(budget, algorithm, space, seed, switches=switches),
                        ("nominal", AROUND),
                    )


def ours(budget: Budget) -> Iterator[Cell]:
    """Our method without each of its parts, and what else might take BATD3 further: our numbers, another choice."""
    for seed in range(budget.seeds):
        for switches in ((), *OURS_SWITCHES):
            yield _spec(budget, OURS, "spatter", seed, switches=switches), ("nominal",)
        yield _spec(budget, "batd3", "spatter", seed, switches=lent("reach")), ("nominal",)
        for choice in CHOICES:
            yield (
                _spec(budget, "batd3", "spatter", seed, switches=(("target_choice", choice),)),
                ("nominal",),
            )


def rivals(budget: Budget) -> Iterator[Cell]:
    """Numbers of the rivals' own varied, as ours are; RLPD with more updates for each step, and then as many steps."""
    for seed in range(budget.seeds):
        for algorithm, switches in RIVALS_SWITCHES:
            for changed in ((), switches):
                yield _spec(budget, algorithm, "spatter", seed, switches=changed), ("nominal",)
        for space in SPACES:
            yield _spec(budget, "rlpd", space, seed, switches=MANY_UPDATES), ("nominal",)
        yield (
            _four_times(_spec(budget, "rlpd", "spatter", seed, switches=MANY_UPDATES)),
            ("nominal",),
        )


def harder(budget: Budget) -> Iterator[Cell]:
    """Capturing and following: ours with one part fewer or more, and others with our numbers, or those for the task."""
    for seed in range(budget.seeds):
        for task in HARDER:
            all_lent, task_lent = lent(task), lent_for_the_task(task)
            cells = [
                (OURS, ()),
                ("batd3", all_lent),
                ("batd3", tuple(item for item in all_lent if item[0] != "self_imitation")),
                ("batd3", task_lent),
                ("td3wd", task_lent),
                ("rbl", task_lent),
                *((OURS, each) for each in HARDER_SWITCHES),
            ]
            for algorithm, switches in cells:
                yield (
                    _spec(budget, algorithm, "anchor", seed, task=task, switches=switches),
                    ("nominal",),
                )


def moving(budget: Budget) -> Iterator[Cell]:
    """Capturing what drifts or tumbles; ours also four times as long."""
    for task in MOVING:
        yield _scripted(task=task), ("nominal",)
    for seed in range(budget.seeds):
        for task in MOVING:
            for algorithm in TASK_METHODS:
                yield _spec(budget, algorithm, "anchor", seed, task=task), ("nominal",)
            yield _four_times(_spec(budget, OURS, "anchor", seed, task=task)), ("nominal",)


def preset(budget: Budget) -> Iterator[Cell]:
    """Which number of the preset `tuned` does it: each put back to the paper's, for BATD3 in Spatter, TD3 in Anchor."""
    for seed in range(budget.seeds):
        for switches in ((), *PUT_BACK):
            for algorithm, space in (("batd3", "spatter"), ("td3", "anchor")):
                yield _spec(budget, algorithm, space, seed, switches=switches), ("nominal",)


def raised(budget: Budget) -> Iterator[Cell]:
    """How little makes BATD3 learn in Spatter: the paper's preset with one number of `tuned` after another."""
    for seed in range(budget.seeds):
        for switches in ((), *RAISED):
            yield (
                _spec(budget, "batd3", "spatter", seed, preset="paper", switches=switches),
                ("nominal",),
            )


def bfloat16(budget: Budget) -> Iterator[Cell]:
    """Updates whose products are in bfloat16, and in float32 as everywhere else: BATD3 and ours in the three spaces."""
    for seed in range(budget.seeds):
        for space in SPACES:
            for algorithm in ("batd3", OURS):
                for switches in (FASTER, ()):
                    yield _spec(budget, algorithm, space, seed, switches=switches), ("nominal",)


def longer(budget: Budget) -> Iterator[Cell]:
    """Four times as long: in Spatter BATD3, ours, and ours with hindsight; in each space ours with practice past it."""
    for seed in range(budget.seeds):
        for algorithm, switches in ((OURS, UNHURRIED), ("batd3", ()), (OURS, ())):
            yield (
                _four_times(_spec(budget, algorithm, "spatter", seed, switches=switches)),
                ("nominal", "disturbances"),
            )
        for switches, spaces in ((PRACTISED, SPACES), ((*PRACTISED, *SYMMETRIC), ("anchor",))):
            for space in spaces:
                spec = _four_times(_spec(budget, OURS, space, seed, switches=switches))
                yield spec, ("nominal", "disturbances", AROUND)


def _four_times(spec: RunSpec) -> RunSpec:
    return replace(spec, updates=4 * spec.updates)


EXPERIMENTS: dict[str, Experiment] = {
    "table2": table2,
    "fig4": fig4,
    "fig5": fig5,
    "table3": table3,
    "table4": table4,
    "fig6": fig6,
    "transfer": transfer,
    "plants": plants,
    "tasks": tasks,
    "symmetry": symmetry,
    "practice": practice,
    "ours": ours,
    "rivals": rivals,
    "harder": harder,
    "moving": moving,
    "bfloat16": bfloat16,
    "longer": longer,
    "preset": preset,
    "paper-preset": paper_preset,
    "raised": raised,
}


def _spec(budget: Budget, algorithm: str, space: str, seed: int, **options: Any) -> RunSpec:
    updates = budget.length(options.get("preset", "tuned"))
    return RunSpec(algorithm, space=space, seed=seed, updates=updates, **options)


def _scripted(**options: Any) -> RunSpec:
    return RunSpec(SCRIPTED, updates=0, **options)


def summary(experiment: str) -> str:
    """What an experiment is, in one line."""
    return (EXPERIMENTS[experiment].__doc__ or "").strip().partition("\n")[0]


def collect(names: Sequence[str], budget: Budget) -> dict[str, Cell]:
    """The runs of some experiments by name, each once, with all its evaluations.

    Seeds are the outermost loop across experiments: cut short, the study has every cell from fewer seeds.

    Raises:
        CdcsrError: there is no such experiment.
    """
    cells: dict[str, Cell] = {}
    for experiment in names:
        if experiment not in EXPERIMENTS:
            raise CdcsrError(unknown_choice("experiment", experiment, EXPERIMENTS))
        for spec, evaluations in EXPERIMENTS[experiment](budget):
            _, before = cells.get(spec.name, (spec, ()))
            cells[spec.name] = spec, tuple(dict.fromkeys((*before, *evaluations)))
    return dict(sorted(cells.items(), key=lambda item: item[1][0].seed))


def expected(budget: Budget) -> dict[str, dict[str, tuple[str, ...]]]:
    """The names of all runs, for each experiment, with the evaluations of them that it needs."""
    return {
        name: {run: evaluations for run, (_, evaluations) in collect([name], budget).items()}
        for name in EXPERIMENTS
    }
