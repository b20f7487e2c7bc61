"""How cost grows: with links, with segments, with copies, and with worker processes."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np

from backends.pybullet.simulation import PybulletSimulation
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


def worker_gain(robot: Robot, copies: int = 32, steps: int = 40, rounds: int = 5) -> float:
    """Steps per second of PyBullet with two worker processes over one, taking turns."""
    simulations = [PybulletSimulation(robot, copies, workers=workers) for workers in (1, 2)]
    commands = -np.random.default_rng(0).random((steps, copies, robot.num_cables))
    times: list[list[float]] = []
    for _ in range(rounds + 1):
        times.append([])
        for simulation in simulations:
            simulation.reset()
            start = time.perf_counter()
            for command in commands:
                simulation.step(command)
            times[-1].append(time.perf_counter() - start)
    for simulation in simulations:
        simulation.close()
    one, two = np.median(times[1:], axis=0)  # the first round compiles
    return float(one / two)


def memory_per_copy(robot: Robot, backend: str, copies: int) -> float:
    """Growth of a process's peak memory for each further copy, in [MB]; each count in a process of its own.

    `copies` must be enough to rise above the peak of starting up. Linux counts what a process had in memory before it
    became another program into its `ru_maxrss`, so there the kernel's other record is read.
    """
    alone = ", workers=0" if backend == "pybullet" else ""  # memory of workers would not be seen
    code = (
        "import pathlib, resource, sys, numpy; "
        "from cdcsr.robot.description import parse_robot; from cdcsr.simulation.contract import load_backend; "
        f"s = load_backend(sys.argv[1])(parse_robot(sys.stdin.read()), int(sys.argv[2]){alone}); "
        "s.step(numpy.zeros((s.num, s.robot.num_cables))); s.close(); "
        "own = pathlib.Path('/proc/self/status'); "
        "print(next(line.split()[1] for line in own.read_text().splitlines() if line.startswith('VmHWM')) "
        "if own.exists() else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    peaks = []
    for count in (1, 1 + copies):
        done = subprocess.run(
            [sys.executable, "-c", code, backend, str(count)],
            input=robot.to_toml(),
            capture_output=True,
            text=True,
            check=True,
        )
        peaks.append(int(done.stdout))
    return (peaks[1] - peaks[0]) / copies / 1024
