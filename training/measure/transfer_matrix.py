"""The transfer matrix: every policy in every engine and space, on held-out targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from cdcsr.envs.disturbances import Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.tables import markdown
from controllers.controller import Controller
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result, evaluate
from training.policy import Policy


@dataclass(frozen=True)
class Cell:
    """One controller in one engine and one space."""

    controller: str
    trained_in: str
    """Engine it was trained in; "-" for a scripted controller."""
    trained_on: str
    """Space it was trained in; "-" for a scripted controller."""
    backend: str
    space: str
    result: Result

    def as_dict(self) -> dict[str, Any]:
        """The cell as plain data, each episode included."""
        return {
            "controller": self.controller,
            "trained_in": self.trained_in,
            "trained_on": self.trained_on,
            "backend": self.backend,
            "space": self.space,
            **self.result.summary(),
            "success": self.result.success.tolist(),
            "length": self.result.length.tolist(),
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
    progress: Callable[[Cell], None] | None = None,
) -> list[Cell]:
    """Measure controllers in engines and spaces.

    Args:
        controllers: policies, or scripted ones.
        robot: the description they are all run on.
        backends, spaces: where.
        episodes: in each cell, as one batch.
        seed: of the targets, the same in every cell of a space; but Floating and Spatter surround the demonstrations
            of each policy, which may be others than those of the next, see :func:`other_targets`.
        disturbances: what goes wrong between policy and robot.
        task: what they are to do.
        progress: called with each cell as it is done.

    Returns:
        Cells, the engine varying fastest.

    Raises:
        CdcsrError: two controllers have one name, by which cells are compared.
    """
    names = [controller.name for controller in controllers]
    if len(set(names)) < len(names):
        raise CdcsrError(f"Controllers must have names of their own; found {', '.join(names)}.")
    cells = []
    for controller in controllers:
        policy = controller if isinstance(controller, Policy) else None
        for space in spaces:
            for backend in backends:
                result = evaluate(
                    controller,
                    robot,
                    backend,
                    space,
                    episodes,
                    seed,
                    centers=None if policy is None else policy.centers,
                    frame_skip=1 if policy is None else policy.frame_skip,
                    disturbances=disturbances,
                    task=task,
                )
                trained = (
                    ("-", "-") if policy is None else (policy.card["backend"], policy.card["space"])
                )
                cells.append(Cell(controller.name, *trained, backend, space, result))
                if progress:
                    progress(cells[-1])
    return cells


@dataclass(frozen=True)
class Disagreement:
    """Paired comparison of one controller in two engines on the same targets."""

    controller: str
    space: str
    backends: tuple[str, str]
    only_first: list[int]
    """Episodes that succeed only in the first engine."""
    only_second: list[int]
    """Episodes that succeed only in the second engine."""
    episodes: int

    @property
    def share(self) -> float:
        """Share of the episodes that end differently."""
        return (len(self.only_first) + len(self.only_second)) / self.episodes

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        first, second = self.backends
        return {
            "controller": self.controller,
            "space": self.space,
            f"only_{first}": self.only_first,
            f"only_{second}": self.only_second,
            "share": self.share,
        }


def disagreements(cells: Sequence[Cell]) -> list[Disagreement]:
    """The paired comparison of every two engines, for each controller and space."""
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
    """A sentence on each controller and space whose targets are not those of the space's first controller."""
    first: dict[str, Cell] = {}
    found: dict[tuple[str, str], str] = {}
    for cell in cells:
        usual = first.setdefault(cell.space, cell)
        if not np.array_equal(cell.result.targets, usual.result.targets):
            found[cell.controller, cell.space] = (
                f"{cell.controller} has other targets in {cell.space} than {usual.controller}: those around its own"
                " demonstrations. The two are not to be compared there."
            )
    return list(found.values())


def format_table(cells: Sequence[Cell]) -> str:
    """The matrix as a Markdown table, one row for each controller and space, and the paired disagreement."""
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
            s = cell.result.summary()
            row += [
                f"{s['success_rate']:.2f} [{s['success_low']:.2f}, {s['success_high']:.2f}]",
                f"{s['length_mean']:.1f} ± {s['length_std']:.1f}",
            ]
        for names in compared:
            pair = pairs[controller, space, names]
            row.append(f"{len(pair.only_first)} / {len(pair.only_second)}")
        rows.append(row)
    return markdown(head, rows)
