"""One run of the study, by what it is; its name follows from that."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, cast

from cdcsr.errors import CdcsrError, unknown_choice
from training.config.run_config import (
    PRESETS,
    AlgorithmName,
    Learner,
    PresetName,
    Train,
    in_a_name,
    learner_for,
)

SCRIPTED = "jacobian"
"""The algorithm of a run that trains nothing: the scripted demonstrator."""


@dataclass(frozen=True)
class RunSpec:
    """What is trained, in what, on what, and from which seed."""

    algorithm: str
    preset: PresetName = "tuned"
    backend: str = "mujoco"
    """The engine it is trained in."""
    space: str = "anchor"
    """The space it is trained in."""
    task: str = "reach"
    seed: int = 0
    demonstrations: int = 10
    updates: int = 6_000
    randomize: float = 0.0
    """Scale of the randomization of the plant in training."""
    switches: tuple[tuple[str, Any], ...] = ()
    """Numbers of the learner that are changed from the preset's: (field, value), in the order of their names."""

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise CdcsrError(unknown_choice("preset", self.preset, PRESETS))
        known = {field.name for field in fields(Learner)}
        for name, _ in self.switches:
            if name not in known:
                raise CdcsrError(unknown_choice("field of the learner", name, known))
        object.__setattr__(self, "switches", tuple(sorted(self.switches)))

    @property
    def name(self) -> str:
        """A folder's name that says what the run is, another one for every other run."""
        parts = [
            f"{self.algorithm}-{self.preset}",
            self.space,
            self.backend,
            f"d{self.demonstrations}",
            f"u{self.updates}",
            f"s{self.seed}",
        ]
        if self.task != "reach":
            parts.append(self.task)
        if self.randomize:
            parts.append(f"r{self.randomize:g}")
        parts += [f"{name}={in_a_name(value)}" for name, value in self.switches]
        return "_".join(parts)

    @property
    def trains(self) -> bool:
        """Whether there is anything to train."""
        return self.algorithm != SCRIPTED

    @property
    def learner(self) -> Learner:
        """The numbers of the learner."""
        own = learner_for(self.algorithm, self.preset, self.task)
        return replace(own, updates=self.updates, **dict(self.switches))

    def train(self, out: Path) -> Train:
        """The training run, in the folder `out`."""
        return Train(
            out,
            algorithm=cast(AlgorithmName, self.algorithm),  # a job refuses what is none
            preset=self.preset,
            backend=self.backend,
            space=self.space,
            task=self.task,
            randomize=self.randomize,
            num_demonstrations=self.demonstrations,
            seed=self.seed,
            learner=self.learner,
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain data; switches by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)} | {
            "switches": dict(self.switches)
        }

    @classmethod
    def from_json(cls, text: str) -> RunSpec:
        """Read :meth:`as_dict` as JSON.

        Raises:
            CdcsrError: it is something else.
        """
        try:
            data = dict(json.loads(text))
            switches = {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in data.pop("switches", {}).items()
            }
            return cls(**data, switches=tuple(switches.items()))
        except (ValueError, TypeError, AttributeError) as error:
            raise CdcsrError(f"{text!r} is not a run of the study: {error}.") from None
