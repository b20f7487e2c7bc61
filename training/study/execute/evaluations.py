"""What is measured of a run once it is trained: one CSV file for each evaluation, one row for each episode."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from cdcsr.envs.disturbances import Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.files import write_text
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import backend_names
from controllers.controller import Controller
from training.config.run_description import RunDescription
from training.measure.evaluation import Result, evaluate
from training.measure.following import MOTIONS, follow
from training.measure.plant_axes import AXES
from training.measure.plant_sweep import Point, sweep
from training.policy import Policy
from training.study.declare.grid import AROUND, SPACES

EPISODE_COLUMNS = ("backend", "space", "axis", "level", "episode", "success", "length", "distance")
FOLLOW_COLUMNS = (
    "backend",
    "motion",
    "episode",
    "step",
    "tip_error",
    "base_position_error",
    "base_attitude_error",
)
FOLLOW_EPISODES = 10
"""At most; each is many rows."""

PLANT_EPISODES = 30
"""At most; there are many plants."""

LEVELS = {
    "action_noise": (0.0, 0.5, 1.0, 1.5, 2.0),
    "base_noise": (0.01, 0.02, 0.03),
    "packet_loss": (0.2, 0.4, 0.6, 0.8, 1.0),
}
"""Of each disturbance of Table IV, in the units of :class:`Disturbances`."""

Row = tuple[Any, ...]


@dataclass(frozen=True)
class Subject:
    """Who is measured."""

    spec: RunDescription
    controller: Controller
    robot: Robot

    @property
    def options(self) -> dict[str, Any]:
        """What of an environment depends on who is measured."""
        policy = self.controller if isinstance(self.controller, Policy) else None
        known = (
            {} if policy is None else {"centers": policy.centers, "frame_skip": policy.frame_skip}
        )
        return {**known, "task": self.spec.task}


@dataclass(frozen=True)
class Evaluation:
    """A file of results."""

    columns: tuple[str, ...]
    measure: Callable[[Subject, int], Iterator[Row]]
    """Of a subject, in so many episodes for each cell; rows in the order of the columns."""
    most: int | None = None
    """Episodes for each cell, at most."""

    def episodes(self, asked: int) -> int:
        """How many episodes each cell has if so many are asked for."""
        return asked if self.most is None else min(asked, self.most)

    def is_done(self, path: Path, asked: int) -> bool:
        """Whether the file is there, with as many episodes as are asked for. A file is complete or absent.

        Raises:
            CdcsrError: it is none that was written here.
        """
        if not path.is_file():
            return False
        try:
            with path.open(newline="", encoding="utf-8") as file:
                last = max((int(row["episode"]) for row in csv.DictReader(file)), default=-1)
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise CdcsrError(
                f"{path} is damaged ({type(error).__name__}: {error}); delete it to have it made again."
            ) from None
        return last + 1 >= self.episodes(asked)

    def write(self, path: Path, subject: Subject, asked: int) -> None:
        """Measure, and write the file as a whole."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.measure(subject, self.episodes(asked)))
        write_text(path, text.getvalue())


def nominal(subject: Subject, episodes: int) -> Iterator[Row]:
    """Undisturbed, in every engine: a reaching policy in all spaces of the paper, another in its own."""
    spec = subject.spec
    spaces = SPACES if spec.task == "reach" and spec.space in SPACES else (spec.space,)
    for space, backend in product(spaces, backend_names()):
        result = evaluate(
            subject.controller, subject.robot, backend, space, episodes, **subject.options
        )
        yield from episode_rows(backend, space, "nominal", 0, result)


def around(subject: Subject, episodes: int) -> Iterator[Row]:
    """Undisturbed, in every engine, all around the arm."""
    for backend in backend_names():
        result = evaluate(
            subject.controller, subject.robot, backend, AROUND, episodes, **subject.options
        )
        yield from episode_rows(backend, AROUND, "nominal", 0, result)


def disturbances(subject: Subject, episodes: int) -> Iterator[Row]:
    """One disturbance at a time, in the engine and space of training (Table IV)."""
    backend, space = subject.spec.backend, subject.spec.space
    for axis, levels in LEVELS.items():
        for level in levels:
            result = evaluate(
                subject.controller,
                subject.robot,
                backend,
                space,
                episodes,
                disturbances=Disturbances(**{axis: level}),
                **subject.options,
            )
            yield from episode_rows(backend, space, axis, level, result)


def following(subject: Subject, episodes: int) -> Iterator[Row]:
    """Targets that move, in every engine (Fig. 6)."""
    known = {name: value for name, value in subject.options.items() if name != "task"}
    for backend, motion in product(backend_names(), MOTIONS):
        for sample in follow(
            subject.controller,
            subject.robot,
            backend,
            subject.spec.space,
            motion,
            episodes,
            **known,
        ):
            motion, episode, step, *errors = sample
            yield backend, motion, episode, step, *(f"{error:.5f}" for error in errors)


def plants(subject: Subject, episodes: int) -> Iterator[Row]:
    """Plants that are ever more wrong, one axis at a time, in every engine, until success halves."""
    space = subject.spec.space
    for backend in backend_names():
        nominal = evaluate(
            subject.controller, subject.robot, backend, space, episodes, **subject.options
        )
        for axis in AXES.values():
            points = [Point(backend, space, axis, axis.nominal, nominal, task=subject.spec.task)]
            if nominal.success.any():  # else there is nothing to lose
                points = sweep(
                    subject.controller,
                    subject.robot,
                    backend,
                    space,
                    axis,
                    episodes=episodes,
                    nominal=points[0],
                    task=subject.spec.task,
                )
            for point in points:
                if point.result is not None:  # the engine could simulate that plant
                    yield from episode_rows(backend, space, axis.name, point.level, point.result)


def episode_rows(
    backend: str, space: str, axis: str, level: float, result: Result
) -> Iterator[Row]:
    """The rows of one cell."""
    for i, (success, length, distance) in enumerate(
        zip(result.success, result.length, result.distance, strict=True)
    ):
        yield backend, space, axis, f"{level:g}", i, int(success), int(length), f"{distance:.5f}"


EVALUATIONS: dict[str, Evaluation] = {
    "nominal": Evaluation(EPISODE_COLUMNS, nominal),
    AROUND: Evaluation(EPISODE_COLUMNS, around),
    "disturbances": Evaluation(EPISODE_COLUMNS, disturbances),
    "plants": Evaluation(EPISODE_COLUMNS, plants, most=PLANT_EPISODES),
    "follow": Evaluation(FOLLOW_COLUMNS, following, most=FOLLOW_EPISODES),
}
"""By name, which is also that of its file."""
