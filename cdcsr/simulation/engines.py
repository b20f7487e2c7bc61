"""Find engines by name: each is an entry point in the group `cdcsr.backends`."""

from __future__ import annotations

import os
from functools import cache
from importlib.metadata import entry_points

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation

_GROUP = "cdcsr.backends"


def backend_names() -> list[str]:
    """Return the names of the installed engines."""
    return sorted({point.name for point in entry_points(group=_GROUP)})


def load_backend(name: str) -> type[Simulation]:
    """Return the Simulation class of an engine.

    Raises:
        CdcsrError: no engine of that name is installed.
    """
    for point in entry_points(group=_GROUP):
        if point.name == name:
            return point.load()
    raise CdcsrError(unknown_choice("backend", name, backend_names()))


@cache
def engine_title(name: str) -> str:
    """Return an engine's title, or the name itself if no such engine is installed."""
    return load_backend(name).title if name in backend_names() else name


def chosen_backends(name: str) -> list[str]:
    """Return the names of the engines that a user means by a name, or by "all".

    Raises:
        CdcsrError: no engine of that name is installed.
    """
    installed = backend_names()
    if name not in [*installed, "all"]:
        raise CdcsrError(unknown_choice("backend", name, [*installed, "all"]))
    chosen = installed if name == "all" else [name]
    for each in chosen:  # an error should come before the work
        load_backend(each)
    return chosen


def make_simulation(robot: Robot, backend: str, num: int = 1) -> Simulation:
    """Make a simulation of `num` copies in an engine.

    Raises:
        CdcsrError: no engine of that name is installed.
    """
    return load_backend(backend)(robot, num)


def processors() -> int:
    """Return how many processors this process may use.

    That is as many as it is bound to, and at most OMP_NUM_THREADS where that is set. Engines
    share their copies among so many threads or worker processes; results do not depend on it.
    """
    bound = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(bound, int(asked)) if asked.isdecimal() and int(asked) else bound
