"""Measure controllers in every engine and space on held-out targets: the transfer matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cdcsr.envs.disturbances import Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tables import markdown
from controllers.controller import Controller
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result, evaluate


@dataclass(frozen=True)
class Cell:
    """One controller in one engine and one space."""

    controller: str
    trained_in: str
    """The engine it was trained in; "-" if it was not trained."""
    trained_on: str
    """The space it was trained in; "-" if it was not trained."""
    backend: str
    space: str
    result: Result

    def as_dict(self) -> dict[str, object]:
        """Return the cell as plain data, each episode included."""
        return {
            "controller": self.controller,
            "trained_in": self.trained_in,
            "trained_on": self.trained_on,
            "backend": self.backend,
            "space": self.space,
            **self.result.summary(),
            "success": self.result.success.tolist(),
            "length": self.result.length.tolist(),
            "targets": self.result.targets.tolist(),
        }


def transfer(
    controllers: Sequence[Controller],
    robot: Robot,
    backends: Sequence[str],
    spaces: Sequence[str],
    episodes: int = 100,
    seed: int = TEST_SEED,
    disturbances: Disturbances | None = None,
    task: str = "reach",
    start: str = "still",
    progress: Callable[[Cell], None] | None = None,
) -> list[Cell]:
    """Measure controllers in engines and spaces.

    Args:
        controllers: policies and scripted controllers.
        robot: the description that they all act on.
        backends, spaces: names of engines and operation spaces.
        episodes: how many episodes in each cell, as one batch.
        seed: seeds the targets. They are the same in every cell of a space, except that Floating
            and Spatter surround the demonstrations of each policy; see :func:`other_targets`.
        disturbances: the disturbances between controller and robot.
        task: the name of the task.
        start: the states in which episodes begin.
        progress: called with each finished cell.

    Returns:
        The cells; the engine varies fastest.

    Raises:
        CdcsrError: two controllers have the same name.
    """
    names = [controller.name for controller in controllers]
    if len(set(names)) < len(names):
        raise CdcsrError(f"Controllers must have different names; found {', '.join(names)}.")
    cells = []
    for controller in controllers:
        trained = controller.engine or "-", controller.space or "-"
        for space in spaces:
            for backend in backends:
                result = evaluate(
                    controller,
                    robot,
                    backend,
                    space,
                    episodes,
                    seed,
                    disturbances=disturbances,
                    task=task,
                    start=start,
                )
                cells.append(Cell(controller.name, *trained, backend, space, result))
                if progress:
                    progress(cells[-1])
    return cells


@dataclass(frozen=True)
class Disagreement:
    """The paired comparison of one controller in two engines on the same targets."""

    controller: str
    space: str
    backends: tuple[str, str]
    only_first: list[int]
    """The episodes that succeed only in the first engine."""
    only_second: list[int]
    """The episodes that succeed only in the second engine."""
    episodes: int

    @property
    def share(self) -> float:
        """The share of the episodes that end differently."""
        return (len(self.only_first) + len(self.only_second)) / self.episodes

    def as_dict(self) -> dict[str, object]:
        """Return the comparison as plain data."""
        first, second = self.backends
        return {
            "controller": self.controller,
            "space": self.space,
            f"only_{first}": self.only_first,
            f"only_{second}": self.only_second,
            "share": self.share,
        }


def disagreements(cells: Sequence[Cell]) -> list[Disagreement]:
    """Compare every two engines, for each controller and space."""
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.controller, cell.space), []).append(cell)
    found = []
    for (controller, space), group in groups.items():
        for a, b in combinations(group, 2):
            first, second = a.result.success, b.result.success
            only = [np.flatnonzero(x & ~y).tolist() for x, y in ((first, second), (second, first))]
            found.append(
                Disagreement(
                    controller, space, (a.backend, b.backend), only[0], only[1], len(first)
                )
            )
    return found


def other_targets(cells: Sequence[Cell]) -> list[str]:
    """Return a sentence for each cell whose targets differ from the first controller's there."""
    first: dict[str, Cell] = {}
    found: dict[tuple[str, str], str] = {}
    for cell in cells:
        usual = first.setdefault(cell.space, cell)
        if not np.array_equal(cell.result.targets, usual.result.targets):
            found[cell.controller, cell.space] = (
                f"{cell.controller} has other targets in {cell.space} than {usual.controller}: "
                "they surround its own demonstrations. Do not compare the two there."
            )
    return list(found.values())


def diverged(cells: Sequence[Cell]) -> list[str]:
    """Return a sentence for each cell in which episodes diverged."""
    return [
        f"{cell.controller} in {cell.backend}, {cell.space}: {cell.result.diverged} of "
        f"{len(cell.result.success)} episodes diverged and count as failures."
        for cell in cells
        if cell.result.diverged
    ]


def format_table(cells: Sequence[Cell]) -> str:
    """Return the matrix as a Markdown table, with a row for each controller and space."""
    backends = list(dict.fromkeys(cell.backend for cell in cells))
    pairs = {(d.controller, d.space, d.backends): d for d in disagreements(cells)}
    head = ["controller", "trained in", "space"]
    for backend in backends:
        head += [f"{backend}: success [95 %]", "length"]
    compared = list(combinations(backends, 2))
    head += [f"only {a} / only {b}" for a, b in compared]
    rows = []
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.controller, cell.space), []).append(cell)
    for (controller, space), group in groups.items():
        row = [
            controller,
            f"{group[0].trained_in}, {group[0].trained_on}".replace("-, -", "-"),
            space,
        ]
        for cell in group:
            result = cell.result
            low, high = result.interval
            row += [
                f"{result.rate:.2f} [{low:.2f}, {high:.2f}]",
                f"{result.length.mean():.1f} ± {result.length.std():.1f}",
            ]
        for names in compared:
            pair = pairs[controller, space, names]
            row.append(f"{len(pair.only_first)} / {len(pair.only_second)}")
        rows.append(row)
    return markdown(head, rows)
