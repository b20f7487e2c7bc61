"""Level 3: the same commands without feedback, with the time step halved again and again.

Both engines integrate one set of equations, so as the step shrinks both must come to one motion. What is left at a
given step is each engine's own discretisation error. Commands are held over the same real time by substeps. The
constraint's recovery time shrinks with the step: it is how fast an engine takes back what a step of that length let
through, a part of the discretisation, and what both engines then converge to is the ideal cable, which is never
longer than at rest. Held fixed instead, it would be a material property, which MuJoCo reads as a critically damped
spring and a complementarity problem as a rate, and each engine would converge to a cable of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backends.parity.checks import Check, Engines, reference_of
from backends.parity.trajectories import DEMONSTRATOR, Commands
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation

Array = NDArray[np.float64]

REFINEMENTS = (1, 2, 4, 8)
"""Into how many parts a time step is divided, level by level."""
FINE = (16, 32)
"""Parts of the time step in the two runs of the reference engine from which the limit is extrapolated."""
DISTANCE = 1e-3
"""Mean distance of the tips over demonstrator episodes at the default time step, in [m]."""
ORDER = 0.8
"""At least this power of the time step. Both engines are of first order; one that converged to another limit would
show an order that falls to zero."""
APART = 0.5
"""Largest distance between engines at the finest step, as a part of the reference's own error there: engines that
converge to one limit come nearer to each other than either is to it."""
DISTURBANCE = 1e-6
"""Standard deviation of the noise on the disturbed run's commands, as a part of their range."""


@dataclass(frozen=True)
class OpenLoop:
    """Tips of R refinements at T instants in N episodes; entries after an episode's end are NaN."""

    commands: str
    time_steps: Array
    """(R,) [s]."""
    time: Array
    """(T,) [s]."""
    tips: dict[str, Array]
    """(R, T, N, 3) by engine, the reference first, in [m]."""
    limit: Array
    """(T, N, 3) what the reference engine's tip converges to, in [m]."""
    noise: Array
    """(T, N) how far slightly disturbed commands move the reference engine's tip, in [m]."""

    @property
    def reference(self) -> str:
        return next(iter(self.tips))

    def errors(self, engine: str) -> Array:
        """Distance from the limit, mean over each episode and then over episodes, shape (R,), in [m]."""
        distance = np.linalg.norm(self.tips[engine] - self.limit, axis=-1)
        return np.nanmean(distance, axis=1).mean(axis=1)

    def order(self, engine: str) -> float:
        """The power of the time step that fits the errors best."""
        return float(np.polyfit(np.log(self.time_steps), np.log(self.errors(engine)), 1)[0])

    def mean_distance(self, engine: str) -> Array:
        """Between the tips of an engine and of the reference, mean as for errors, shape (R,), in [m]."""
        return np.nanmean(self.distance(engine), axis=1).mean(axis=1)

    def distance(self, engine: str) -> Array:
        """Between the tips of an engine and of the reference, shape (R, T, N), in [m]."""
        return np.linalg.norm(self.tips[engine] - self.tips[self.reference], axis=-1)

    def checks(self) -> list[Check]:
        """Distance at the default step, along the demonstrator; one limit, of first order, along any commands."""
        checks = []
        for engine in self.tips:
            checks.append(
                Check(
                    3,
                    "order",
                    f"{engine}, {self.commands}",
                    self.order(engine),
                    ORDER,
                    "",
                    at_least=True,
                )
            )
        own = self.errors(self.reference)[-1]
        for engine in list(self.tips)[1:]:
            pair, mean = f"{engine} - {self.reference}, {self.commands}", self.mean_distance(engine)
            if self.commands == DEMONSTRATOR:
                checks.append(Check(3, "mean tip distance", pair, float(mean[0]), DISTANCE, "m"))
            finest = "tip distance over own error at the finest step"
            checks.append(Check(3, finest, pair, float(mean[-1] / own), APART, "relative"))
        return checks

    def as_dict(self) -> dict[str, Any]:
        """The figures as plain data."""
        return {
            "commands": self.commands,
            "episodes": self.noise.shape[1],
            "time_steps": self.time_steps.tolist(),
            "limit_extrapolated_from_time_steps": [
                float(self.time_steps[0] / parts) for parts in FINE
            ],
            "errors": {engine: self.errors(engine).tolist() for engine in self.tips},
            "order": {engine: self.order(engine) for engine in self.tips},
            "tip_distance": {
                engine: {
                    "mean": self.mean_distance(engine).tolist(),
                    "max": np.nanmax(self.distance(engine), axis=(1, 2)).tolist(),
                }
                for engine in list(self.tips)[1:]
            },
            "noise_floor": {
                "disturbance": DISTURBANCE,
                "mean": float(np.nanmean(self.noise, axis=0).mean()),
                "max": float(np.nanmax(self.noise)),
            },
        }


def refined(robot: Robot, parts: int) -> Robot:
    """The robot with its time step, and the time in which constraints recover, divided."""
    constraint = robot.constraint.model_copy(
        update={"recovery_time": robot.constraint.recovery_time / parts}
    )
    return robot.model_copy(update={"time_step": robot.time_step / parts, "constraint": constraint})


def open_loop(
    robot: Robot,
    engines: Engines,
    commands: Commands,
    progress: Callable[[int], object] | None = None,
) -> OpenLoop:
    """Run all engines under the same commands at every refinement.

    Args:
        robot: the description.
        engines: the reference first.
        commands: one for each default time step.
        progress: called with the number of simulation steps just made.
    """
    reference = engines[reference_of(engines)]

    def run(
        make: Callable[[Robot, int], Simulation], parts: int, values: Array = commands.values
    ) -> Array:
        simulation = make(refined(robot, parts), len(values))
        tips = []
        for command in values.swapaxes(0, 1):
            simulation.step(command, parts)
            tips.append(simulation.state().tip_position)
            if progress:
                progress(parts * len(command))
        simulation.close()
        return np.where(commands.active[..., None], np.array(tips), np.nan)

    tips = {
        name: np.stack([run(make, parts) for parts in REFINEMENTS])
        for name, make in engines.items()
    }
    eta = np.array([servo.eta for servo in robot.servos])
    disturbance = DISTURBANCE * eta * np.random.default_rng(0).normal(size=commands.values.shape)
    noise = np.linalg.norm(
        run(reference, 1, commands.values + disturbance) - tips[reference_of(engines)][0], axis=-1
    )
    coarse, fine = (run(reference, parts) for parts in FINE)
    steps = robot.time_step / np.array(REFINEMENTS)
    time = robot.time_step * np.arange(1, commands.values.shape[1] + 1)
    return OpenLoop(commands.name, steps, time, tips, 2 * fine - coarse, noise)
