"""Find engines by name: each is an entry point in the group `cdcsr.backends`.

A user may add options to a name wherever one is asked for, `pybullet:substeps=4` for example;
:attr:`cdcsr.simulation.contract.Simulation.options_type` declares those of an engine. Names joined
by "+", `mujoco+pybullet` for example, mean one simulation whose copies are in several engines.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points

from pydantic import ValidationError

from cdcsr.errors import (
    CdcsrError,
    CdcsrWarning,
    MissingPackage,
    missing_package,
    unknown_choice,
)
from cdcsr.robot.description import Robot
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.contract import EngineOptions, Simulation
from cdcsr.simulation.mixed import mixed_engine
from cdcsr.simulation.plant import Parameters

_GROUP = "cdcsr.backends"
_EXTRA = re.compile(r"([\w.-]+)[^;]*;.*\bextra == [\"'](.+?)[\"']")
"""A requirement of an extra, in a package's metadata: the package, and the extra."""
_FORMER = {"pybullet-former": "PyBullet (former kernel)"}
"""Titles of engines that are gone; stored results still name them. In this one the project's own
kernel found the accelerations, and Bullet was given the forces that reproduce them."""


@cache
def _declared(path: tuple[str, ...]) -> dict[str, EntryPoint]:  # noqa: ARG001 (the cache's key)
    """Find the engines by name in the packages on Python's `path`; a search takes 10 ms."""
    return {point.name: point for point in entry_points(group=_GROUP)}


@cache
def _installed(path: tuple[str, ...]) -> frozenset[str]:
    """Return the names of the declared engines but those of extras that are not installed."""
    return frozenset(name for name, point in _declared(path).items() if _complete(point))


def _complete(point: EntryPoint) -> bool:
    """Return whether the packages are there that an engine's entry point asks for by an extra, as
    in `name = module:class [extra]`."""
    lines = (point.dist.requires or []) if point.extras and point.dist else []
    asked = [found for line in lines if (found := _EXTRA.match(line)) and found[2] in point.extras]
    try:
        return all(distribution(found[1]) for found in asked)
    except PackageNotFoundError:
        return False


def backend_names() -> list[str]:
    """Return the names of the installed engines; an engine of an extra is one if its packages are
    there."""
    return sorted(_installed(tuple(sys.path)))


def optional_engines() -> list[str]:
    """Return the names of the engines whose extra is not installed."""
    path = tuple(sys.path)
    return sorted(_declared(path).keys() - _installed(path))


def principal_engines() -> list[str]:
    """Return the names of the installed engines that are no variant of another; see
    :attr:`cdcsr.simulation.contract.Simulation.variant_of`."""
    return [name for name in working_engines() if load_backend(name).variant_of is None]


def working_engines() -> list[str]:
    """Return the names of the installed engines whose own packages are installed too.

    Warns:
        CdcsrWarning: an engine is left out.

    Raises:
        CdcsrError: there is none.
    """
    working, missing = [], []
    for name in backend_names():
        try:
            load_backend(name)
            working.append(name)
        except MissingPackage as error:
            missing.append(str(error))
    if not working:
        raise CdcsrError(f"No engine can be used. {' '.join(missing)}".strip())
    for message in missing:
        warnings.warn(f"{message} It is left out.", CdcsrWarning, stacklevel=2)
    return working


def load_backend(name: str) -> type[Simulation]:
    """Return the Simulation class of an engine; options in `name` are checked.

    Raises:
        CdcsrError: no engine of that name is installed, or an option is wrong.
    """
    parts = _parts(name)
    if len(parts) == 1:
        return _backend_with_options(name)[0]
    return mixed_engine(name, [_backend_with_options(part) for part in parts])


def _parts(name: str) -> list[str]:
    """Return the engines that a name joins; the sign of an exponent, as in 1e+06, joins nothing."""
    return re.split(r"\+(?!\d)", name)


def engine_title(name: str) -> str:
    """Return an engine's title, or the name itself if the engine is unknown or cannot be loaded."""
    if len(parts := _parts(name)) > 1:
        return " and ".join(map(engine_title, parts))
    bare, _, options = name.partition(":")
    if bare not in _declared(tuple(sys.path)):
        return _FORMER.get(name, name)
    try:
        title = load_backend(name).title
    except MissingPackage:  # stored results may name it
        return name
    return title + (f" ({options.replace(',', ', ')})" if options else "")


def chosen_backends(name: str, robot: Robot) -> list[str]:
    """Return the names of the engines that a user means by a name, or by "all".

    Warns:
        CdcsrWarning: "all" leaves out an engine, because it cannot be used or lacks an ability that
            the robot needs.

    Raises:
        CdcsrError: no engine of that name is installed, an option is wrong, or the name joins
            several engines; or no engine is left.
    """
    installed = backend_names()
    if len(_parts(name)) > 1:
        raise CdcsrError(
            f"Only training and demonstrations take several engines side by side; found {name!r}. "
            "Choose one engine, or all."
        )
    bare = name.partition(":")[0]
    if bare not in [*installed, *optional_engines(), "all"]:
        raise CdcsrError(unknown_choice("backend", bare, [*installed, "all"]))
    if name == "all":
        return _able(working_engines(), robot)
    load_backend(name)  # an error should come before the work
    return [name]


def _able(names: list[str], robot: Robot) -> list[str]:
    """Keep the engines that have the abilities which a robot needs."""
    able, plant = [], Parameters().plant(robot, 1)
    for name in names:
        engine = load_backend(name)
        try:
            engine.check_robot(robot, plant, engine.options_type())
            able.append(name)
        except CdcsrError as error:
            if name == names[-1] and not able:
                raise
            warnings.warn(f"{error} It is left out.", CdcsrWarning, stacklevel=3)
    return able


def engine_factory(name: str) -> Callable[[Robot, int], Simulation]:
    """Return what makes simulations of a number of copies in an engine.

    Raises:
        CdcsrError: no engine of that name is installed, or an option is wrong.
    """
    if len(_parts(name)) > 1:
        mixed = load_backend(name)
        steps = [_backend_with_options(part)[1].steps for part in _parts(name)]
        return lambda robot, num: mixed(_warned(robot, min(steps)), num)
    kind, options = _backend_with_options(name)
    return lambda robot, num: kind(_warned(robot, options.steps), num, options)


def switched_off(name: str) -> list[str]:
    """Return an engine's name with one of its own settings set to the description's, for each."""
    if len(_parts(name)) > 1:
        return []
    bare, _, listed = name.partition(":")
    given = dict(pair.split("=") for pair in listed.split(",") if pair)
    names = []
    for key, value in load_backend(name).switches.items():
        options = given | {key: value}
        names.append(f"{bare}:" + ",".join(f"{k}={v}" for k, v in options.items()))
    return names


def make_simulation(robot: Robot, backend: str, num: int = 1) -> Simulation:
    """Make a simulation of `num` copies in an engine.

    Args:
        robot: the description.
        backend: the engine's name, with options or without.
        num: how many copies.

    Warns:
        CdcsrWarning: the time step is so large that springs may shake.

    Raises:
        CdcsrError: no engine of that name is installed, or an option is wrong.
    """
    return engine_factory(backend)(robot, num)


def _warned(robot: Robot, steps: int) -> Robot:
    """Return the robot; warn if its time step, made in so many steps, is above the stable one."""
    stable = stable_step(robot)
    if robot.time_step > stable * steps:
        warnings.warn(
            f"The time_step of {robot.name!r} is above {steps * stable:.2g} s. Below that no "
            "spring shakes; above it the motion may be wrong, or end in an error.",
            CdcsrWarning,
            stacklevel=3,
        )
    return robot


def _backend_with_options(text: str) -> tuple[type[Simulation], EngineOptions]:
    """Return the class and the options that are meant by `name` or `name:key=value,key=value`."""
    name, colon, listed = text.partition(":")
    points = _declared(tuple(sys.path))
    if name not in points:
        raise CdcsrError(unknown_choice("backend", name, backend_names()))
    try:
        backend: type[Simulation] = points[name].load()
    except ModuleNotFoundError as error:
        raise missing_package(f"The engine {name}", error) or error from None
    fields = backend.options_type.model_fields
    values: dict[str, str] = {}
    for pair in listed.split(",") if colon else []:
        key, equals, value = pair.partition("=")
        if not equals or key in values:
            raise CdcsrError(
                f"Options of an engine are written name:key=value,key=value, each key once; "
                f"found {text!r}."
            )
        if key not in fields:
            raise CdcsrError(unknown_choice(f"option of the engine {name}", key, fields))
        values[key] = value
    try:
        return backend, backend.options_type(**values)
    except ValidationError as error:
        first = error.errors()[0]
        raise CdcsrError(
            f"Engine {name}, option {first['loc'][0]}: {first['msg']}; found {first['input']!r}."
        ) from None


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
