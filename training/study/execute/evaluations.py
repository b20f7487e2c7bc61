"""Measure a trained policy: each evaluation writes a CSV file, with a row for each episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TypedDict

from cdcsr.envs.disturbances import Disturbances
from cdcsr.files import write_text
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import backend_names, principal_engines
from cdcsr.tables import csv_text
from cdcsr.tasks.catalogue import make_task
from controllers.controller import Controller
from training.config.run_description import RunDescription
from training.measure.evaluation import Array, Result, evaluate
from training.measure.following import MOTIONS, follow
from training.measure.plant_axes import AXES
from training.measure.plant_sweep import Point, sweep
from training.policy import Policy
from training.study.declare.grid import AROUND, SPACES
from training.study.store import EPISODE_KINDS, FOLLOW_KINDS, read_csv

EPISODE_COLUMNS, FOLLOW_COLUMNS = tuple(EPISODE_KINDS), tuple(FOLLOW_KINDS)
FOLLOW_EPISODES = 10
"""Most episodes of an evaluation of target following; each has many rows."""

PLANT_EPISODES = 30
"""Most episodes for each plant; there are many plants."""

LEVELS = {
    "action_noise": (0.0, 0.5, 1.0, 1.5, 2.0),
    "base_noise": (0.01, 0.02, 0.03),
    "packet_loss": (0.2, 0.4, 0.6, 0.8, 1.0),
}
"""Levels of each disturbance of Table IV, in the units of :class:`Disturbances`."""

Row = tuple[str | int | float, ...]


class Options(TypedDict, total=False):
    """The options of an environment that depend on who is measured."""

    centers: Array | None
    frame_skip: int | None
    task: str
    start: str


@dataclass(frozen=True)
class Subject:
    """The controller that is measured, its run and its robot."""

    spec: RunDescription
    controller: Controller
    robot: Robot

    @property
    def options(self) -> Options:
        """The options of an environment that depend on who is measured."""
        options = Options(task=self.spec.task, start=self.spec.start)
        if isinstance(self.controller, Policy):
            options["centers"] = self.controller.centers
            options["frame_skip"] = self.controller.frame_skip
        return options


@dataclass(frozen=True)
class Evaluation:
    """A kind of measurement, whose results fill one file."""

    columns: tuple[str, ...]
    measure: Callable[[Subject, int], Iterator[Row]]
    """Measures a subject, in so many episodes for each cell; yields rows."""
    most: int | None = None
    """The most episodes for each cell."""

    def episodes(self, asked: int) -> int:
        """Return how many episodes each cell has if `asked` are asked for."""
        return asked if self.most is None else min(asked, self.most)

    def is_done(self, path: Path, asked: int) -> bool:
        """Return whether the file is there, with at least as many episodes as are asked for.

        Raises:
            CdcsrError: the file is damaged.
        """
        if not path.is_file():
            return False
        episode = read_csv(path, {"episode": int})["episode"]
        return int(episode.max(initial=-1)) + 1 >= self.episodes(asked)

    def write(self, path: Path, subject: Subject, asked: int) -> None:
        """Measure a subject and write the file as a whole."""
        rows = self.measure(subject, self.episodes(asked))
        write_text(path, csv_text(self.columns, rows))


def nominal(subject: Subject, episodes: int) -> Iterator[Row]:
    """Measure in every engine: reaching in all the paper's spaces, other tasks in their own."""
    spec = subject.spec
    spaces = SPACES if spec.task == "reach" and spec.space in SPACES else (spec.space,)
    for space, backend in product(spaces, backend_names()):
        result = evaluate(
            subject.controller, subject.robot, backend, space, episodes, **subject.options
        )
        yield from episode_rows(backend, space, "nominal", 0, result)


def around(subject: Subject, episodes: int) -> Iterator[Row]:
    """Measure in every engine, in the whole workspace."""
    for backend in backend_names():
        result = evaluate(
            subject.controller, subject.robot, backend, AROUND, episodes, **subject.options
        )
        yield from episode_rows(backend, AROUND, "nominal", 0, result)


def engines(subject: Subject, episodes: int) -> Iterator[Row]:
    """Measure in every engine, in the space of training, and from still starts, so that all recipes
    have the same episodes."""
    space, options = subject.spec.space, Options(**subject.options)
    options["start"] = "still"
    for backend in backend_names():
        result = evaluate(subject.controller, subject.robot, backend, space, episodes, **options)
        yield from episode_rows(backend, space, "nominal", 0, result)


def disturbances(subject: Subject, episodes: int) -> Iterator[Row]:
    """Measure under one disturbance at a time, in engine and space of training (Table IV)."""
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
    """Measure how targets that move are followed, in every engine that is no variant (Fig. 6)."""
    policy = subject.controller if isinstance(subject.controller, Policy) else None
    for backend, motion in product(principal_engines(), MOTIONS):
        for motion_name, episode, step, *errors in follow(
            subject.controller,
            subject.robot,
            backend,
            subject.spec.space,
            motion,
            episodes,
            centers=None if policy is None else policy.centers,
            frame_skip=None if policy is None else policy.frame_skip,
        ):
            yield backend, motion_name, episode, step, *(f"{error:.5f}" for error in errors)


def plants(subject: Subject, episodes: int) -> Iterator[Row]:
    """Sweep each axis of the plant in every engine that is no variant, until success halves."""
    space = subject.spec.space
    for backend in principal_engines():
        task = make_task(subject.spec.task, subject.robot)
        nominal = evaluate(
            subject.controller, subject.robot, backend, space, episodes, **subject.options
        )
        for axis in (each.on(subject.robot) for each in AXES.values()):
            points = [Point(backend, space, axis, axis.nominal, nominal, task=task)]
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
                    start=subject.spec.start,
                )
            for point in points:
                if point.result is not None:  # the engine could simulate that plant
                    yield from episode_rows(backend, space, axis.name, point.level, point.result)


def episode_rows(
    backend: str, space: str, axis: str, level: float, result: Result
) -> Iterator[Row]:
    """Yield the rows of one cell."""
    for i, (success, length, distance) in enumerate(
        zip(result.success, result.length, result.distance, strict=True)
    ):
        yield backend, space, axis, f"{level:g}", i, int(success), int(length), f"{distance:.5f}"


EVALUATIONS: dict[str, Evaluation] = {
    "nominal": Evaluation(EPISODE_COLUMNS, nominal),
    AROUND: Evaluation(EPISODE_COLUMNS, around),
    "engines": Evaluation(EPISODE_COLUMNS, engines),
    "disturbances": Evaluation(EPISODE_COLUMNS, disturbances),
    "plants": Evaluation(EPISODE_COLUMNS, plants, most=PLANT_EPISODES),
    "follow": Evaluation(FOLLOW_COLUMNS, following, most=FOLLOW_EPISODES),
}
"""All evaluations by name, which is also the name of the file."""
