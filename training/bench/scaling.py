"""How cost grows: with links, with segments, with copies, and with worker processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np

from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import make_simulation

LINKS = (6, 12, 24, 48)
SEGMENTS = (1, 2, 3, 4)


def resized(robot: Robot, segments: int, links: int) -> Robot:
    """A robot of so many segments with so many links in all, its parts those of the first segment of `robot`."""
    data = robot.model_dump()
    segment = data["segments"][0]
    data["segments"] = [
        segment | {"links": len(part)} for part in np.array_split(np.arange(links), segments)
    ]
    return Robot.model_validate(data)


def step_seconds(
    robot: Robot,
    backend: str,
    copies: int = 4,
    steps: int = 40,
    rounds: int = 5,
    read: bool = False,
) -> float:
    """Median processor time of one step of one copy, in [s], under gentle random commands.

    With `read`, its state is read after each step, too.
    """
    simulation = make_simulation(robot, backend, copies)
    commands = -0.2 * np.random.default_rng(0).random((steps, copies, robot.num_cables))
    simulation.step(commands[0])  # compiles
    times = []
    for _ in range(rounds):
        simulation.reset()
        start = time.process_time()
        for command in commands:
            simulation.step(command)
            if read:
                simulation.state()
        times.append(time.process_time() - start)
    simulation.close()
    return float(np.median(times)) / (steps * copies)


def exponent(sizes: tuple[int, ...], seconds: list[float]) -> float:
    """The p of the best fit of cost ~ size^p."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


@dataclass(frozen=True)
class Growth:
    """What a step of one copy costs, in [us], by the number of links (in two segments) and of segments (12 links)."""

    links: dict[int, float]
    segments: dict[int, float]
    links_exponent: float
    segments_exponent: float


def growth(robot: Robot, backend: str) -> Growth:
    """Measure an engine."""
    by_links = [step_seconds(resized(robot, 2, links), backend) for links in LINKS]
    by_segments = [step_seconds(resized(robot, segments, 12), backend) for segments in SEGMENTS]
    return Growth(
        dict(zip(LINKS, (1e6 * s for s in by_links), strict=True)),
        dict(zip(SEGMENTS, (1e6 * s for s in by_segments), strict=True)),
        exponent(LINKS, by_links),
        exponent(SEGMENTS, by_segments),
    )


def memory_per_copy(robot: Robot, backend: str) -> float:
    """Return the growth of a process's peak memory with each further copy, in [MB].

    The number of copies doubles until the peak lies well above that of a process with one copy.
    """
    one, copies = _peak_memory(robot, backend, 1), 64
    while (peak := _peak_memory(robot, backend, 1 + copies)) < 1.5 * one:
        copies *= 2
    return (peak - one) / copies


def _peak_memory(robot: Robot, backend: str, copies: int) -> float:
    """Return the peak memory in [MB] of a process of its own that makes a step of some copies.

    One thread: memory of worker processes would not be seen. On Linux, `ru_maxrss` counts what the
    process had in memory before it became another program, so the kernel's other record is read.
    """
    code = (
        "import pathlib, resource, sys, numpy; "
        "from cdcsr.robot.description import parse_robot; "
        "from cdcsr.simulation.engines import make_simulation; "
        "s = make_simulation(parse_robot(sys.stdin.read()), sys.argv[1], int(sys.argv[2])); "
        "s.step(numpy.zeros((s.num, s.robot.num_cables))); s.close(); "
        "own = pathlib.Path('/proc/self/status'); "
        "lines = own.read_text().splitlines() if own.exists() else []; "
        "peaks = [line.split()[1] for line in lines if line.startswith('VmHWM')]; "
        "print(*peaks or [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, backend, str(copies)],
        input=robot.to_toml(),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    return int(done.stdout) / 1024
