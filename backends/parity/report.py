"""Measure all three levels on one robot, and report them as text and as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from backends.parity.checks import Check, Engines
from backends.parity.one_state import one_state
from backends.parity.one_step import OneStep, one_step
from backends.parity.open_loop import REFINEMENTS, OpenLoop, accuracy, open_loop
from backends.parity.trajectories import Commands
from cdcsr.robot.description import Robot
from cdcsr.robot.stability import stable_step


@dataclass(frozen=True)
class Parity:
    """The measurements on one robot."""

    robot: Robot
    engines: tuple[str, ...]
    """Their names, the reference first."""
    one_state: list[Check]
    one_step: list[OneStep]
    open_loop: list[OpenLoop]

    @property
    def checks(self) -> list[Check]:
        """All checks, level by level."""
        parts = [*self.one_step, *self.open_loop]
        return self.one_state + [check for part in parts for check in part.checks()]

    @property
    def failed(self) -> list[Check]:
        """The checks that failed. A failure at one level explains those at the levels after it."""
        return [check for check in self.checks if not check.passed]

    def as_dict(self) -> dict[str, object]:
        """Return everything as plain data for JSON; lengths are in [m]."""
        failed = self.failed
        return {
            "robot": self.robot.name,
            "fingerprint": self.robot.fingerprint,
            "reference": self.engines[0],
            "engines": list(self.engines),
            "passed": not failed,
            "first_failure": str(failed[0]) if failed else None,
            "checks": [check.as_dict() for check in self.checks],
            "one_step": [part.as_dict() for part in self.one_step],
            "open_loop": [part.as_dict() for part in self.open_loop],
        }


def measure(
    robot: Robot,
    engines: Engines,
    runs: Sequence[Commands],
    seed: int,
    progress: bool = False,
    switches: Mapping[str, Engines] | None = None,
) -> Parity:
    """Run all three levels.

    Args:
        robot: the description.
        engines: the engines, the reference first.
        runs: the commands for levels 2 and 3.
        seed: draws the states of level 1.
        progress: whether to show a bar on the standard error.
        switches: by engine, the same engine with one setting set to the description's.
    """
    states = one_state(robot, engines, seed=seed)
    steps: list[OneStep] = []
    loops: list[OpenLoop] = []
    variants = len(engines) * sum(REFINEMENTS) + sum(map(len, (switches or {}).values()))
    total = sum(run.values.shape[0] * run.values.shape[1] * (2 + variants) for run in runs)
    with tqdm(total=total, unit="step", disable=None if progress else True) as bar:
        for commands in runs:
            bar.set_description(f"one step, {commands.name}")
            steps += one_step(robot, engines, commands, bar.update)
        for commands in runs:
            bar.set_description(f"open loop, {commands.name}")
            loops.append(open_loop(robot, engines, commands, bar.update, switches))
    return Parity(robot, tuple(engines), states, steps, loops)


def show(parity: Parity) -> str:
    """Return the measurements as text to read."""
    robot, others = parity.robot, ", ".join(parity.engines[1:])
    lines = [f"{robot.name} ({robot.fingerprint}): {others} against {parity.engines[0]}"]
    step, stable = 1e3 * robot.time_step, 1e3 * stable_step(robot)
    lines.append(f"time step {step:.4g} ms; no spring shakes below {stable:.4g} ms")
    lines += ["", "1  one state: largest difference at random states"]
    lines += [_line(check) for check in parity.one_state]
    for part in parity.one_step:
        lines += ["", *_show_one_step(part)]
    for part in parity.open_loop:
        lines += ["", *_show_open_loop(part, accuracy(robot))]
    count, failed = len(parity.checks), parity.failed
    verdict = f"first failure: {failed[0]}" if failed else "all within tolerance"
    return "\n".join([*lines, "", f"{count - len(failed)} of {count} checks hold; {verdict}"])


def _show_one_step(part: OneStep) -> list[str]:
    head = f"{'':<24}{'median':>10}{'95 %':>10}{'largest':>10}    95 % of the quantity itself"
    lines = [
        f"2  one step: {part.pair}, {part.states} states, {part.commands} commands",
        f"     {head}",
    ]
    for name, row in part.distributions().items():
        numbers = "".join(f"{value:>10.1e}" for value in (row["median"], row["p95"], row["max"]))
        lines.append(f"     {name:<24}{numbers}    {row['size_p95']:.2g} {row['unit']}")
    return lines + [_line(check) for check in part.checks() if not check.passed]


def _show_open_loop(part: OpenLoop, error: float) -> list[str]:
    episodes, engines = part.noise.shape[1], list(part.tips)

    def row(name: str, values: Iterable[float], digits: str) -> str:
        return f"     {name:<40}" + "".join(f"{1e3 * value:>10.{digits}}" for value in values)

    lines = [
        f"3  open loop: {episodes} episodes, {part.commands} commands, mean over time in [mm]",
        row("time step in [ms]", part.time_steps, "4g"),
    ]
    for engine in engines:
        errors = row(f"{engine}, from its limit", part.errors(engine), "4f")
        lines.append(f"{errors}    order {part.order(engine):.2f}")
    steps = [part.accurate_step(engine, error) for engine in engines]
    named = ", ".join(f"{engine} {1e3 * h:.2g}" for engine, h in zip(engines, steps, strict=True))
    lines.append(f"     steps in [ms] with an error of {1e3 * error:g} mm: {named}")
    for engine in engines[1:]:
        lines.append(row(f"{engine} - {part.reference}", part.mean_distance(engine), "5f"))
    for engine in engines[1:]:
        apart = [part.limit_distance(engine)]
        lines.append(row(f"limit of {engine} - {part.reference}", apart, "4f"))
    for name, moved in part.switches.items():
        lines.append(row(f"{name} moves it by", [float(np.nanmean(moved))], "4f"))
    lines.append(row("noise floor (commands off 1e-6)", [part.noise_floor], "5f"))
    return lines + [_line(check) for check in part.checks() if not check.passed]


def _line(check: Check) -> str:
    mark = "ok  " if check.passed else "FAIL"
    place = f"  at {check.where}" if check.where and not check.passed else ""
    measured = f"{check.value:>9.1e} {check.unit:<9}({check.bound})"
    return f"{mark} {check.name:<26}{check.pair:<28}{measured}{place}"
