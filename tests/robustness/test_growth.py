"""Steps, resets and environments that come and go leave no memory and no open files behind."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.envs.single_env import TaskEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names, make_simulation, principal_engines

ROBOT = load_robot("planar-single")
PAGE = os.sysconf("SC_PAGE_SIZE")
MOST_GROWTH = 16e6
"""Growth of the resident memory that is no leak, in bytes: an allocator keeps some of what it is
given back, more so in a process that has run many tests (8.4 MB was seen). In the fast test a leak
of one State a step is 21 MB or more, and one of a PyBullet client an environment 270 MB."""


def used() -> tuple[int, int]:
    """Return the resident memory in bytes and the number of open files of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * PAGE, sum(1 for _ in Path("/proc/self/fd").iterdir())


def grown(work: Callable[[int], None], first: int, count: int) -> tuple[int, int]:
    """Return by how much memory and open files grow in `count` rounds after `first` ones."""
    work(first)
    before = used()
    work(count)
    after = used()
    return after[0] - before[0], after[1] - before[1]


def check(engine: str, steps: int, resets: int, environments: int) -> None:
    gc.collect()
    gc.freeze()  # what other tests left is not searched a dozen times
    with_steps = make_simulation(ROBOT, engine, 2)
    rng = np.random.default_rng(0)

    def step(count: int) -> None:
        for _ in range(count):
            with_steps.step(rng.uniform(-0.02, 0.0, (2, ROBOT.num_cables)))
            with_steps.state()

    env = TaskVectorEnv(2, ROBOT, engine)

    def reset(count: int) -> None:
        for seed in range(count):
            env.reset(seed=seed)
            env.step(np.zeros((2, ROBOT.num_cables)))

    def come_and_go(count: int) -> None:
        for _ in range(count):
            short = TaskEnv(robot=ROBOT, backend=engine)
            short.reset(seed=0)
            short.close()

    works = (step, steps), (reset, resets), (come_and_go, environments)
    for work, count in works:
        memory, files = grown(work, max(5, count // 10), count)
        print(f"{engine}, {work.__name__}: {memory / 1e6:+.1f} MB, {files:+d} open files")
        assert memory < MOST_GROWTH, (work.__name__, memory)
        assert files <= 0, (work.__name__, files)
    with_steps.close()
    env.close()


@pytest.mark.parametrize("engine", principal_engines())
def test_nothing_grows(engine: str) -> None:
    check(engine, 8_000, 100, 10)


@pytest.mark.slow
@pytest.mark.parametrize("engine", backend_names())
def test_nothing_grows_in_300000_steps_10000_resets_and_400_environments(engine: str) -> None:
    check(engine, 300_000, 10_000, 400)
