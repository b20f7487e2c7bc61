"""How fast physics and learning are on a GPU: every number of a run that never leaves it."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.engines import make_simulation
from training.algorithms.registry import ALGORITHMS, find_algorithm
from training.config.run_description import Changes
from training.device.doors import open_door
from training.run.device_first import share_demonstrations
from training.run.device_parts import DeviceParts, make_parts
from training.run.device_run import train_on_device
from training.run.metrics import read_metrics
from training.run.setup import Setup
from training.run.train_options import Train

_PACKAGES = "torch", "mujoco", "mujoco-warp", "warp-lang", "cdcsr"


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    engine: str = "warp"
    copies: tuple[int, ...] = (1_024, 8_192, 65_536)
    peer_copies: int = 8_192
    """The copies of `mujoco` on the processors."""
    steps: int = 200
    seeds: int = 10
    reach_minutes: float = 1.0
    capture_minutes: float = 2.0
    changes: Changes = ()
    """Numbers of the learner that are not those of the preset `gpu`."""
    evaluate_every: int = 500
    evaluate_episodes: int = 100
    methods: tuple[str, ...] = tuple(name for name, one in ALGORITHMS.items() if one.learner)
    """The grid whose duration is estimated has these methods."""
    spaces: int = 3


def gpu(robot: Robot, device: torch.device, extent: Extent | None = None) -> Iterator[Measurement]:
    """Measure steps, updates, and the time until policies reach and capture.

    Args:
        robot: the description.
        device: where everything is.
        extent: how much is measured.

    Raises:
        CdcsrError: there is no GPU, or the engine's packages are missing.
    """
    if device.type == "cuda" and not torch.cuda.is_available():
        raise CdcsrError("PyTorch finds no GPU here, and the section gpu measures nothing else.")
    extent = extent or Extent()
    yield _machine(device)
    yield from _physics(robot, device, extent)
    yield from _learner(device, extent)
    yield from _success(device, extent)
    yield from _grid(device, extent)


def _machine(device: torch.device) -> Measurement:
    name = torch.cuda.get_device_name() if device.type == "cuda" else platform.processor()
    return Measurement(
        "gpu_name", None, f"device: {name or device.type}", details={"gpu_versions": _versions()}
    )


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "missing"
    return found


def _physics(robot: Robot, device: torch.device, extent: Extent) -> Iterator[Measurement]:
    """Measure steps of all copies, and those of `mujoco` on all processors."""
    rates = {}
    for copies in extent.copies:
        start = time.perf_counter()
        simulation = make_simulation(robot, extent.engine, copies)
        with closing(simulation):
            door = open_door(simulation, device)
            commands = -0.03 * torch.rand(copies, robot.num_cables, device=device)
            for _ in range(5):
                door.step_device(commands)
            _wait(device)
            ready = time.perf_counter() - start
            seconds = _seconds(partial(door.step_device, commands), extent.steps, device)
        rates[copies] = copies / seconds
        yield Measurement(
            f"gpu_steps_{copies}",
            rates[copies] / 1e6,
            f"million steps/s of {copies:,} copies in {extent.engine}",
            f"ready after {ready:.0f} s, compilation included where there was any",
        )
    with closing(make_simulation(robot, "mujoco", extent.peer_copies)) as simulation:
        pulled = np.full((extent.peer_copies, robot.num_cables), -0.01)
        simulation.step(pulled)
        seconds = _seconds(partial(simulation.step, pulled), 10, torch.device("cpu"))
    peer = extent.peer_copies / seconds
    nearest = min(rates, key=lambda copies: abs(copies - extent.peer_copies))
    yield Measurement(
        "gpu_over_mujoco",
        rates[nearest] / peer,
        f"steps/s of {nearest:,} copies over those of mujoco on all processors",
        f"mujoco: {peer / 1e6:.3f} million steps/s",
    )


def _learner(device: torch.device, extent: Extent) -> Iterator[Measurement]:
    """Measure updates, and steps with two updates, of one run and of many side by side."""
    rounds: dict[int, float] = {}
    for seeds in (1, extent.seeds):
        with TemporaryDirectory() as folder:
            config = _config(Path(folder), extent, "spatter", "reach", None, seeds)
            with closing(_begun(config, device)) as parts:
                update, step = _timed(parts, device, extent.steps)
        rounds[seeds] = step
        runs = "one run" if seeds == 1 else f"{seeds} runs side by side"
        yield Measurement(f"gpu_update_{seeds}", 1e3 * update, f"ms an update of {runs}")
        yield Measurement(
            f"gpu_step_{seeds}", 1e3 * step, f"ms a step of all copies and two updates of {runs}"
        )
    yield Measurement(
        "gpu_seeds_over_one",
        rounds[extent.seeds] / rounds[1],
        f"time of {extent.seeds} runs side by side over that of one",
    )


def _grid(device: torch.device, extent: Extent) -> Iterator[Measurement]:
    """Estimate how long all seeds of all methods take in all spaces, a method after the other.

    What each needs before it learns is measured whole, then some of its updates, without the
    measurements on validation targets.
    """
    total, runs = 0.0, extent.spaces * extent.seeds
    for method in extent.methods:
        start = time.perf_counter()
        with TemporaryDirectory() as folder:
            config = _config(Path(folder), extent, "spatter", "reach", None, runs)
            config = replace(config, algorithm=method, updates=0, changes=_known(method, extent))
            with closing(_begun(config, device)) as parts:
                _wait(device)
                ready = time.perf_counter() - start
                step = _timed(parts, device, extent.steps)[1]
            updates = parts.learner.learner.updates
        minutes = (ready + step * updates / 2) / 60
        total += minutes
        yield Measurement(
            f"gpu_grid_{method}",
            minutes,
            f"min for {updates:,} updates of {runs} runs of {method}, estimated",
            f"ready after {ready:.0f} s",
        )
    yield Measurement("gpu_grid", total, f"min for all methods with {runs} runs each, estimated")


def _known(method: str, extent: Extent) -> Changes:
    """Return the changed numbers that a method has."""
    known = find_algorithm(method).numbers.model_fields
    return tuple((name, value) for name, value in extent.changes if name in known)


def _begun(config: Train, device: torch.device) -> DeviceParts:
    """Make the parts of the runs of all seeds, which have begun."""
    setups = [Setup(one) for one in config.each_seed()]
    share_demonstrations(setups)
    return make_parts(setups, device)


def _timed(parts: DeviceParts, device: torch.device, rounds: int) -> tuple[float, float]:
    """Return the seconds of an update, and of a step with two updates."""
    number = count(1)

    def both() -> None:
        parts.learner.collector.step()
        for _ in range(2):
            parts.learner.update(next(number))

    for _ in range(10):  # the first calls are captured
        both()
    update = _seconds(lambda: parts.learner.update(next(number)), 2 * rounds, device)
    return update, _seconds(both, rounds, device)


def _success(device: torch.device, extent: Extent) -> Iterator[Measurement]:
    """Measure how long seeds side by side take until they reach, and until they capture."""
    cases = (
        ("spatter", "reach", extent.reach_minutes, (0.95, 0.97)),
        ("anchor", "capture", extent.capture_minutes, (0.95,)),
    )
    for space, task, minutes, rates in cases:
        with TemporaryDirectory() as folder:
            config = _config(Path(folder) / "runs", extent, space, task, minutes, extent.seeds)
            train_on_device(config, device)
            curve = mean_curve([one.out for one in config.each_seed()])
        for rate in rates:
            reached = [60 * at for at, success in curve if success >= rate]
            best = max(success for _, success in curve)
            yield Measurement(
                f"gpu_{task}_{rate:g}",
                reached[0] if reached else None,
                f"s until {extent.seeds} seeds have {rate:g} of the validation targets on "
                f"average ({task}, {space})",
                f"{best:.3f} at best in {60 * curve[-1][0]:.0f} s",
                details={f"gpu_{task}_curve": curve},
            )


def mean_curve(folders: Sequence[Path]) -> list[tuple[float, float]]:
    """Return the minutes and mean success rates of runs that were measured together."""
    tables = [read_metrics(folder / "metrics.csv") for folder in folders]
    return [
        (rows[0]["minutes"], float(np.mean([row["success_rate"] for row in rows])))
        for rows in zip(*tables, strict=True)
    ]


def _config(
    out: Path, extent: Extent, space: str, task: str, minutes: float | None, seeds: int
) -> Train:
    return Train(
        algorithm="clasp",
        preset="gpu",
        backend=extent.engine,
        space=space,
        task=task,
        out=out,
        device="cuda",
        seeds=f"0:{seeds}",
        stop_after=minutes,
        evaluate_every=extent.evaluate_every,
        evaluate_episodes=extent.evaluate_episodes,
        updates=1_000_000,
        changes=extent.changes,
    )


def _seconds(work: Callable[[], object], times: int, device: torch.device) -> float:
    """Return the mean time of a piece of work, in [s]."""
    work()
    _wait(device)
    start = time.perf_counter()
    for _ in range(times):
        work()
    _wait(device)
    return (time.perf_counter() - start) / times


def _wait(device: torch.device) -> None:
    """Wait until the device has done all that it was given."""
    if device.type == "cuda":
        torch.cuda.synchronize()
