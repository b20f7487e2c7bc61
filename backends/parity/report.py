"""All three levels for one robot, and what came of them as text and as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

from backends.parity.checks import Check, Engines
from backends.parity.one_state import one_state
from backends.parity.one_step import OneStep, one_step
from backends.parity.open_loop import FINE, REFINEMENTS, OpenLoop, open_loop
from backends.parity.trajectories import Commands
from cdcsr.robot.description import Robot


@dataclass(frozen=True)
class Parity:
    """What was measured on one robot."""

    robot: Robot
    engines: tuple[str, ...]
    """The reference first."""
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
        """The checks that do not hold; what fails at one level explains the levels after it."""
        return [check for check in self.checks if not check.passed]

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain data, ready for JSON; lengths in [m]."""
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
    robot: Robot, engines: Engines, runs: Sequence[Commands], seed: int, progress: bool = False
) -> Parity:
    """Run all three levels.

    Args:
        robot: the description.
        engines: the reference first.
        runs: the commands that levels two and three are measured along.
        seed: of the states of level one.
        progress: show a bar on the standard error.
    """
    states = one_state(robot, engines, seed=seed)
    steps: list[OneStep] = []
    loops: list[OpenLoop] = []
    with tqdm(
        total=sum(_work(run, engines) for run in runs), unit="step", disable=not progress
    ) as bar:
        for commands in runs:
            bar.set_description(f"one step, {commands.name}")
            steps += one_step(robot, engines, commands, bar.update)
        for commands in runs:
            bar.set_description(f"open loop, {commands.name}")
            loops.append(open_loop(robot, engines, commands, bar.update))
    return Parity(robot, tuple(engines), states, steps, loops)


def show(parity: Parity) -> str:
    """The measurements as text to read."""
    failed = parity.failed
    engines = ", ".join(parity.engines[1:])
    lines = [
        f"{parity.robot.name} ({parity.robot.fingerprint}): {engines} against {parity.engines[0]}"
    ]
    lines += [
        "",
        "1  one state: largest difference at random states",
        *map(_line, parity.one_state),
    ]
    for part in parity.one_step:
        data = part.as_dict()
        lines += [
            "",
            f"2  one step: {data['pair']}, {data['states']} states, {data['commands']} commands",
        ]
        lines.append(
            f"     {'':<24}{'median':>10}{'95 %':>10}{'largest':>10}    95 % of the quantity itself"
        )
        for name, row in data["differences"].items():
            numbers = "".join(f"{row[key]:>10.1e}" for key in ("median", "p95", "max"))
            lines.append(f"     {name:<24}{numbers}    {row['size_p95']:.2g} {row['unit']}")
        lines += [_line(check) for check in part.checks() if not check.passed]
    for part in parity.open_loop:
        lines += [
            "",
            f"3  open loop: {part.noise.shape[1]} episodes, {part.commands} commands, mean over time in [mm]",
        ]
        lines.append(
            f"     {'time step in [ms]':<32}"
            + "".join(f"{1e3 * step:>10.4g}" for step in part.time_steps)
        )
        for engine in part.tips:
            numbers = "".join(f"{1e3 * error:>10.4f}" for error in part.errors(engine))
            lines.append(
                f"     {engine + ', from the limit':<32}{numbers}    order {part.order(engine):.2f}"
            )
        for engine in parity.engines[1:]:
            numbers = "".join(f"{1e3 * mean:>10.5f}" for mean in part.mean_distance(engine))
            lines.append(f"     {engine + ' - ' + part.reference:<32}{numbers}")
        floor = 1e3 * part.as_dict()["noise_floor"]["mean"]
        lines.append(f"     {'noise floor (commands off 1e-6)':<32}{floor:>10.5f}")
        lines += [_line(check) for check in part.checks() if not check.passed]
    count = len(parity.checks)
    verdict = f"first failure: {failed[0]}" if failed else "all within tolerance"
    return "\n".join([*lines, "", f"{count - len(failed)} of {count} checks hold; {verdict}"])


def _line(check: Check) -> str:
    mark = "ok  " if check.passed else "FAIL"
    bound = "at least" if check.at_least else "at most"
    place = f"  at {check.where}" if check.where and not check.passed else ""
    measured = f"{check.value:>9.1e} {check.unit:<9}({bound} {check.tolerance:.3g})"
    return f"{mark} {check.name:<26}{check.pair:<28}{measured}{place}"


def _work(commands: Commands, engines: Engines) -> int:
    """How many steps levels 2 and 3 make along some commands, all copies together."""
    states = commands.values.shape[0] * commands.values.shape[1]
    return states * (1 + len(engines) * sum(REFINEMENTS) + 1 + sum(FINE))
