"""One training run, described once: for the trainer, the study, its records and its tables."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, cast, get_args

from tyro.conf import Suppress

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.reading import check_name
from cdcsr.simulation.arguments import MOST_COPIES, MOST_SEED, MOST_SKIP, check_count
from cdcsr.simulation.randomization import check_scale
from cdcsr.tasks.starts import StartName, start_name
from training.config.seeds import EVALUATION_SEEDS

PresetName = Literal["paper-reading", "tuned", "gpu"]
"""`paper-reading` fills the gaps of the BATD3 paper with our reading. The paper does not print
the numbers of updates and of environment steps, the updates for each step, the exploration noise,
the action rate, the updates and rollouts of the clone, Anchor's place and size, the demonstrator,
the servo, the slider or the cables' radius. `tuned` is what learns well here. `gpu` is
the same with as many copies, and batches as large, as keep a graphics card busy."""
RENAMED = {"paper": "paper-reading"}
"""Names of presets in older files."""
NEAREST = "nearest"
"""The algorithm of a run that trains nothing: the nearest demonstration, replayed open loop."""
SCRIPTED = "jacobian"
"""The algorithm of a run that trains nothing: the scripted demonstrator."""
Changes = tuple[tuple[str, object], ...]
"""Changed numbers of a learner: (name, value) for each."""


@dataclass(frozen=True, kw_only=True)
class RunDescription:
    """Say what is trained, in which engine, for which task, and from which seed."""

    algorithm: str = "batd3"
    """The method that learns."""
    preset: PresetName = "tuned"
    """Where the learner's numbers come from; each can be set with --learner.NAME."""
    backend: str = "mujoco"
    """The engine to train in."""
    robot: str = "paper"
    """The name of a shipped robot, or a path that ends in .toml."""
    space: str = "anchor"
    """Where targets lie: anchor, floating, spatter, workspace, or a file: a map from
    `cdcsr workspace`, or the mesh of debris (.stl, .obj, .ply, .glb)."""
    task: str = "reach"
    """The task: reach, precise, quiet, capture, capture-drift, capture-tumble, follow-line, ..."""
    start: StartName = "still"
    """How episodes begin, demonstrations too: still, moving or anywhere (see
    `cdcsr.tasks.starts`)."""
    frame_skip: int | None = None
    """Simulation steps for which each action is held; by default the robot's own number, 1 for the
    paper's robot."""
    threshold: float | None = None
    """The tip is on the target within this distance, in m; by default the robot's own."""
    seconds: float | None = None
    """How long an episode may take, in s; by default the robot's own."""
    radius: float | None = None
    """The radius of the balls of Floating or Spatter, in m; by default the robot's own."""
    randomize: float = 0.0
    """Domain randomization: every training episode has a plant of its own, drawn from the ranges of
    `cdcsr.simulation.randomization` times this scale; 0 is off."""
    soften: float = 0.0
    """In every training episode all cables stretch, by up to this times the largest strain of
    `cdcsr.simulation.randomization`; 0 is off. The engine must know elastic cables."""
    demonstrations: Path | None = None
    """A dataset from `cdcsr demonstrate`; by default demonstrations are recorded."""
    num_demonstrations: int = 10
    """How many demonstrations are recorded if no dataset is given."""
    demonstration_seed: int = 0
    """Seed of the targets of the demonstrations that are recorded if no dataset is given."""
    seed: int = 0
    """Seed of everything random in the run but the demonstrations."""
    updates: Suppress[int] = 0
    """Length of training; 0 is the preset's."""
    changes: Suppress[Changes] = ()
    """Numbers of the learner that differ from the algorithm's own, in the order of their names."""

    def __post_init__(self) -> None:
        start_name(self.start)
        if self.preset not in get_args(PresetName):
            raise CdcsrError(unknown_choice("preset", self.preset, get_args(PresetName)))
        check_count("seed", self.seed, MOST_SEED, least=0)
        if self.seed in EVALUATION_SEEDS:
            what = EVALUATION_SEEDS[self.seed]
            raise CdcsrError(f"seed {self.seed} draws the {what}; give another seed.")
        check_count("demonstration_seed", self.demonstration_seed, MOST_SEED, least=0)
        if self.demonstration_seed in EVALUATION_SEEDS:
            raise CdcsrError(
                "demonstration_seed must not draw evaluation targets "
                f"({', '.join(map(str, EVALUATION_SEEDS))}), found {self.demonstration_seed}."
            )
        check_count("num_demonstrations", self.num_demonstrations, MOST_COPIES, least=0)
        if self.frame_skip is not None:
            check_count("frame_skip", self.frame_skip, MOST_SKIP)
        check_count("updates", self.updates, 1_000_000_000, least=0)
        check_scale(self.randomize)
        check_scale(self.soften)
        object.__setattr__(self, "changes", tuple(sorted(self.changes)))

    @property
    def trains(self) -> bool:
        """Whether there is anything to train."""
        return self.algorithm not in (SCRIPTED, NEAREST)

    @property
    def randomized(self) -> bool:
        """Whether the plants of training differ from the description."""
        return self.randomize > 0 or self.soften > 0

    @property
    def task_numbers(self) -> dict[str, float]:
        """Numbers of the task that are not the robot's own, by name."""
        found = {"threshold": self.threshold, "seconds": self.seconds, "radius": self.radius}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def name(self) -> str:
        """The name of the run in the study: it says what the run is, and no two runs share one."""
        parts = [
            f"{self.algorithm}-{self.preset}",
            self.space,
            self.backend,
            f"d{self.num_demonstrations}",
            f"u{self.updates}",
            f"s{self.seed}",
        ]
        if self.demonstration_seed:
            parts.append(f"e{self.demonstration_seed}")
        if self.task != "reach":
            parts.append(self.task)
        if self.start != "still":
            parts.append(self.start)
        if self.randomize:
            parts.append(f"r{self.randomize:g}")
        if self.soften:
            parts.append(f"soft{self.soften:g}")
        parts += [f"{name}={value:g}" for name, value in self.task_numbers.items()]
        return "_".join([*parts, *(f"{name}={in_a_name(value)}" for name, value in self.changes)])

    def policy_name(self, algorithm: str, changes: Changes) -> str:
        """Return the name of a policy of this run.

        Args:
            algorithm: the run's, or "bc" for its clone.
            changes: those of the learner's numbers that the policy depends on.
        """
        where = self.space if self.task == "reach" else f"{self.task}-{self.space}"
        where += "" if self.start == "still" else f"-{self.start}"
        parts = [algorithm, self.preset, where, self.backend, f"s{self.seed}"]
        parts += [f"{name}={value:g}" for name, value in self.task_numbers.items()]
        return "-".join([*parts, *(f"{name}={in_a_name(value)}" for name, value in changes)])

    def as_dict(self) -> dict[str, object]:
        """Return plain data that :meth:`from_dict` reads."""
        data = {one.name: getattr(self, one.name) for one in fields(RunDescription)}
        dataset = None if self.demonstrations is None else str(self.demonstrations)
        for name in {"threshold", "seconds", "radius"} - set(self.task_numbers):
            del data[name]  # older records have no such number
        if not self.soften:
            del data["soften"]  # likewise
        if self.frame_skip is None and self.robot == "paper":
            data["frame_skip"] = 1  # the same
        return {**data, "demonstrations": dataset, "changes": dict(self.changes)}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> RunDescription:
        """Read what :meth:`as_dict` gave, also after a way through JSON.

        Older records call the changes `switches`, and have the number of demonstrations where the
        dataset stands now.

        Raises:
            CdcsrError: it is something else.
        """
        try:
            values = {"preset": "tuned", **data}
            changes: dict[str, object] = {}
            for name in ("changes", "switches"):
                changes |= cast(dict[str, object], values.pop(name, None) or {})
            dataset = values.pop("demonstrations", None)
            if values.get("robot", "paper") == "paper" and values.get("frame_skip") == 1:
                del values["frame_skip"]  # the paper's robot's own
            if isinstance(dataset, int):
                values["num_demonstrations"], dataset = dataset, None
            values["preset"] = RENAMED.get(str(values["preset"]), values["preset"])
            for name in ("algorithm", "backend", "space", "task"):
                if name in values:
                    check_name(f"The {name} of a run", values[name])
            return RunDescription(
                **values,  # type: ignore[arg-type]
                demonstrations=None if dataset is None else Path(str(dataset)),
                changes=tuple(
                    (name, tuple(value) if isinstance(value, list) else value)
                    for name, value in changes.items()
                ),
            )
        except (ValueError, TypeError) as error:
            raise CdcsrError(f"{data!r} does not describe a run: {error}.") from None


def in_a_name(value: object) -> str:
    """Write a number of the learner as it stands in a name."""
    if isinstance(value, tuple):
        return "x".join(in_a_name(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value).lower()
