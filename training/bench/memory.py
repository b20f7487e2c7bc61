"""How much memory a further copy takes in each engine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.engines import engine_title, principal_engines

_CODE = """
import pathlib, resource, sys, numpy
from cdcsr.robot.description import parse_robot
from cdcsr.simulation.engines import make_simulation
simulation = make_simulation(parse_robot(sys.stdin.read()), sys.argv[1], int(sys.argv[2]))
simulation.step(numpy.zeros((simulation.num, simulation.robot.num_cables)))
simulation.close()
status = pathlib.Path("/proc/self/status")
lines = status.read_text().splitlines() if status.exists() else []
peaks = [line.split()[1] for line in lines if line.startswith("VmHWM")]
print(*peaks or [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss])
"""


def memory(robot: Robot) -> Iterator[Measurement]:
    """Measure the memory of a copy in every installed engine that is no variant."""
    for engine in principal_engines():
        what = f"{engine_title(engine)}: MB of peak memory for each further copy"
        yield Measurement(f"memory_{engine}", memory_per_copy(robot, engine), what)


def memory_per_copy(robot: Robot, engine: str) -> float:
    """Return the growth of a process's peak memory with each further copy, in [MB].

    The number of copies doubles until the peak lies well above that of a process with one copy.
    """
    one, copies = _peak_memory(robot, engine, 1), 64
    while (peak := _peak_memory(robot, engine, 1 + copies)) < 1.5 * one:
        copies *= 2
    return (peak - one) / copies


def _peak_memory(robot: Robot, engine: str, copies: int) -> float:
    """Return the peak memory in [MB] of a process of its own that makes a step of some copies.

    One thread: memory of worker processes would not be seen. On Linux, `ru_maxrss` counts what the
    process had in memory before it became another program, so the kernel's other record is read.
    """
    done = subprocess.run(
        [sys.executable, "-c", _CODE, engine, str(copies)],
        input=robot.to_toml(),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    return int(done.stdout) / 1024
