"""Success by how far targets are from the nearest demonstration: what a learner adds to what it was shown."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot import Robot, load_robot
from cdcsr.spaces import demonstration_targets, make_space
from training.seeds import TEST_SEED
from training.study.cells import COST, TRAINED, Table, Value, cost, measure, trained
from training.study.records import DEMONSTRATIONS, JACOBIAN, REACH, SPACES, Run, at_home, grouped
from training.study.statistics import rate
from training.study.tables import basis

ROBOT = "paper"
"""The robot of the study; of another the targets are not known here."""
TOLD = ("anchor", "spatter")
"""Spaces of targets near a demonstration and far from all. In Floating they are within 10 mm of one."""
BOUNDS = (0.0, 0.03, 0.06, 0.09, np.inf)
"""Of the distances that are told apart, in [m]; the first is the paper's threshold."""


def nearness(runs: Sequence[Run]) -> Table:
    """Success on held-out targets near a demonstration and far from all, by task, in space and engine of training."""
    robot = load_robot(ROBOT)
    chosen = [run for run in runs if run.fingerprint == robot.fingerprint and _as_shown(run)]
    tasks = sorted({run.setting.task for run in chosen}, key=lambda task: (task != REACH, task))
    rows: list[list[Value]] = []
    for task in tasks:
        own = [run for run in chosen if run.setting.task == task]
        for space in TOLD:
            for setting, group in grouped(own, "space").items():
                cell = measure(seeds := at_home(group, space), "nominal", space=space)
                if cell is None:
                    continue
                far = [distances(robot, space, len(one)) for one in cell.episodes]
                values: list[Value] = []
                for low, high in pairwise(BOUNDS):
                    found = [
                        one.success[(low <= metres) & (metres < high)]
                        for one, metres in zip(cell.episodes, far, strict=True)
                    ]
                    values += [len(found[0]), rate(found) if len(found[0]) else "-"]
                rows.append([task, SPACES[space], *trained(setting), *values, *cost(seeds)])
    names = [
        f"to {1e3 * high:g} mm" if np.isfinite(high) else f"from {1e3 * low:g} mm" for low, high in pairwise(BOUNDS)
    ]
    head = ("task", "space", *TRAINED, *(x for name in names for x in (f"targets {name}", f"κ {name}")), *COST)
    note = (
        "Held-out targets by their distance to the nearest of the ten that were demonstrated, for preset `tuned`: "
        "in Anchor Space some are far from all of them, which is not to be seen from success as a whole. "
    )
    return Table("nearness", "Near a demonstration, and far from all", note + basis(chosen), head, rows)


def distances(robot: Robot, space: str, num: int) -> NDArray[np.float64]:
    """How far the held-out targets of a space are from the nearest demonstration's, shape (num,), in [m].

    Args:
        robot: the study's.
        space: one whose demonstrations are those of Anchor Space.
        num: how many targets, as they are drawn at once.
    """
    shown = demonstration_targets(robot, DEMONSTRATIONS)
    targets = make_space(space, robot, shown).sample(np.random.default_rng(TEST_SEED), num)
    return np.linalg.norm(targets[:, None] - shown, axis=-1).min(axis=1)


def _as_shown(run: Run) -> bool:
    """Whether a run saw the ten demonstrations, and is what its algorithm is by itself; or is the demonstrator's."""
    s = run.setting
    plain = s.preset == "tuned" and s.demonstrations == DEMONSTRATIONS and not s.switches and not s.randomize
    return s.space in TOLD and (plain or s.algorithm == JACOBIAN)
