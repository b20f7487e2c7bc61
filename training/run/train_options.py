"""How a training run is carried out, and what its folder holds."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal, Self

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.folders import WorkingFolder
from cdcsr.reading import exists
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.arguments import MOST_COPIES, check_count, check_number
from training.algorithms.registry import differences, numbers_of, own_numbers
from training.config.learner import Cloning, Network
from training.config.run_description import RENAMED, Changes, RunDescription
from training.run.trackers import TrackerName

STATE, SUMMARY = "state.safetensors", "summary.json"
"""While a run is unfinished its folder holds the first; once it is finished, the second."""
FIRST, SHOWN = "first.safetensors", "demonstrations.safetensors"
"""The rows with which the replay of an unfinished run on a device began, and the demonstrations
that it recorded."""
RUN_FOLDER = WorkingFolder(
    "a training run",
    record="config.json",
    fields=frozenset({"algorithm", "learner"}),
    results=(
        SUMMARY,
        STATE,
        "state.next.safetensors",
        FIRST,
        SHOWN,
        "metrics.csv",
        "policy.json",
        "policy.safetensors",
        "tensorboard/events.*",
        "clone/policy.json",
    ),
)
MOST_SEEDS = 1_000
_RETIRED = {
    "final_learning_rate": 1.0,
    "step_cost": 0.0,
    "target_choice": "softmax",
    "scaled_values": False,
    "keep_successes": False,
}
"""Options of older versions, with the values at which they did nothing."""


@dataclass(frozen=True, kw_only=True)
class Train(RunDescription):
    """A training run and how it is carried out."""

    out: Path
    """The folder of the run. To resume an interrupted run, give its folder and the same options."""
    evaluate_every: int = 1_000
    """Updates between evaluations on validation targets, and checkpoints; 0 for none before the
    end."""
    evaluate_episodes: int = 100
    """Episodes of each evaluation."""
    stop_after: float | None = None
    """Stop after this many minutes; the run can be resumed."""
    track: TrackerName | None = None
    """Also log the metrics to Weights & Biases, offline into the run's folder, or to trackio."""
    force: bool = False
    """Begin anew in a folder that holds another run."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the learner is: cpu, or cuda for a GPU that it never leaves if the engine is `warp`."""
    seeds: str | None = None
    """With device cuda: train seeds side by side, 0:10 for 0 to 9, in the folders s0, s1, ... of
    `out`."""
    json: Path | None = None
    """Also write the summary to this file; for several seeds those of all runs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("num_demonstrations", self.num_demonstrations, MOST_COPIES)
        check_count("evaluate_episodes", self.evaluate_episodes, MOST_COPIES)
        check_count("evaluate_every", self.evaluate_every, 1_000_000_000, least=0)
        if self.stop_after is not None:
            check_number("stop_after", self.stop_after, 0.0, 1e6)
        if self.device not in ("cpu", "cuda"):
            raise CdcsrError(unknown_choice("device", self.device, ["cpu", "cuda"]))
        if self.seeds is not None and self.device == "cpu":
            raise CdcsrError("seeds needs device cuda; with device cpu start a run for each seed.")
        if self.seeds is not None and self.seed != 0:
            raise CdcsrError(f"Give seed or seeds; found seed {self.seed}, seeds {self.seeds!r}.")

    def each_seed(self) -> list[Self]:
        """Return the run of each seed, in a folder of its own if `seeds` is given.

        Raises:
            CdcsrError: `seeds` is not two numbers, the first below the second.
        """
        if self.seeds is None:
            return [self]
        first, colon, end = self.seeds.partition(":")
        if not (colon and first.isdecimal() and end.isdecimal() and len(first + end) < 30):
            raise CdcsrError(f"seeds must be like 0:10, which are 0 to 9; found {self.seeds!r}.")
        check_count("the number of seeds", int(end) - int(first), MOST_SEEDS)
        return [
            replace(self, seed=seed, seeds=None, out=self.out / f"s{seed}")
            for seed in range(int(first), int(end))
        ]

    @property
    def learner(self) -> Network:
        """The numbers of the learner.

        Raises:
            CdcsrError: the algorithm is unknown, or a changed number is not one of its own or out
                of bounds.
        """
        return numbers_of(self)

    def changes_of(self, algorithm: str) -> Changes:
        """Return the changed numbers that a policy depends on, by name.

        The number of updates is not among them; every policy's card has it.

        Args:
            algorithm: the run's, or "bc" for its clone, which depends on few of them.
        """
        own = own_numbers(self.algorithm, self.preset, self.task)
        names = Cloning.model_fields if algorithm == "bc" else self.learner.model_dump()
        found = differences(self.learner, own)
        return tuple((name, value) for name, value in found if name in names and name != "updates")

    def identity(self, robot: Robot, dataset: str | None = None) -> dict[str, object]:
        """Return, as plain data, all that must be the same for a run to be resumed.

        Args:
            robot: the description, with the run's numbers of the task.
            dataset: digest of the demonstrations if a dataset is given; another dataset may have
                come under the same name.
        """
        data = self.as_dict()
        del data["changes"], data["updates"]
        if not self.randomize:
            del data["randomize"]  # older runs have no such option
        if not self.demonstration_seed:
            del data["demonstration_seed"]  # the same
        if self.start == "still":
            del data["start"]  # the same
        if self.frame_skip is None:
            data["frame_skip"] = ruler(robot).frame_skip
        if self.device != "cpu":
            data["device"] = self.device  # it draws other random numbers
        if scale := robot.scale.model_dump(mode="json"):
            data["scale"] = scale
        data |= {"learner": self.learner.model_dump(mode="json"), "fingerprint": robot.fingerprint}
        return data if dataset is None else {**data, "dataset": dataset}


def is_unfinished(folder: Path) -> bool:
    """Return whether a folder holds a run that was stopped before its end."""
    return exists(folder / STATE) and not exists(folder / SUMMARY)


def train_options(
    run: RunDescription, out: Path, *, evaluate_every: int = 1_000, evaluate_episodes: int = 100
) -> Train:
    """Return how a described run is carried out in a folder."""
    described = {one.name: getattr(run, one.name) for one in fields(RunDescription)}
    return Train(
        **described, out=out, evaluate_every=evaluate_every, evaluate_episodes=evaluate_episodes
    )


def read_older(
    found: dict[str, object], run: Train, now: dict[str, object], path: Path
) -> dict[str, object]:
    """Return the record of a run as this version would have written it.

    Older versions recorded every option of every algorithm. Options that this algorithm does not
    read are dropped, and so are retired options at the values at which they did nothing.

    Args:
        found: the record.
        run: the run that is asked for.
        now: its record; older ones have no digest of a map.
        path: of the record, for messages.

    Raises:
        CdcsrError: the run used an option that is retired.
    """
    learner = found.get("learner")
    if not isinstance(learner, dict):
        return found
    for name, idle in _RETIRED.items():
        if learner.get(name, idle) != idle:
            raise CdcsrError(
                f"{path} is of a run with {name} = {learner[name]}, an option that this version no "
                "longer has; finish it with the version that began it, or give another folder."
            )
    if found.get("algorithm") == run.algorithm:
        # An option that is younger than the run had the value that is its default now.
        younger = type(run.learner)().model_dump(mode="json")
        learner = {name: learner.get(name, value) for name, value in younger.items()}
    usual = Train(out=path).as_dict()
    for name in ("changes", "updates", "randomize", "demonstration_seed", "start"):
        del usual[name]
    preset = str(found.get("preset"))
    usual |= {name: value for name, value in now.items() if name in ("map", "debris")}
    return {**usual, **found, "preset": RENAMED.get(preset, preset), "learner": learner}
