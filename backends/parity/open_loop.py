"""Level 3: the same commands without feedback, while the time step is halved again and again.

All engines integrate one set of equations, so as the step shrinks they must converge to one motion.
At a given step the distance from this limit is the engine's own discretization error. By substeps,
commands are held for the same time at every step size. The recovery time of the constraints shrinks
with the step: it says how fast an engine takes back what a step let through, so it is a part of the
discretization, and the limit is the ideal cable, which is never longer than at rest. A fixed
recovery time would be a property of the material. MuJoCo would read it as a critically damped
spring, and a complementarity problem as a rate, and each engine would converge to its own cable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backends.parity.checks import Check, Engines, reference_of
from backends.parity.trajectories import DEMONSTRATOR, Commands
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array, Simulation

REFINEMENTS = (1, 2, 4, 8)
"""Into how many parts the time step is divided, one refinement after the other."""
FINE = (16, 32)
"""Into how many parts it is divided in the two runs of the reference engine from which the limit is
extrapolated."""
DISTANCE = 1e-3
"""The largest allowed mean distance of the tips over demonstrator episodes at the default time
step, in [m]."""
ORDER = 0.8
"""Errors must shrink with at least this power of the time step. Semi-implicit Euler is of first
order; the order of an engine that converges to another limit falls to zero."""
APART = 0.5
"""The largest allowed distance between engines at the finest step, as a part of the reference's own
error there: engines that converge to one limit come nearer to each other than either is to it."""
DISTURBANCE = 1e-6
"""The standard deviation of the noise on the commands of the disturbed run, as a part of their
range."""


@dataclass(frozen=True)
class OpenLoop:
    """The tips in R refinements at T instants in N episodes. Entries after an episode's end are
        NaN;
    lengths are in [m]."""

    commands: str
    time_steps: Array
    """In [s], shape (R,)."""
    time: Array
    """In [s], shape (T,)."""
    tips: dict[str, Array]
    """The positions by engine, the reference first, shape (R, T, N, 3)."""
    limit: Array
    """The position to which the reference engine's tip converges, shape (T, N, 3)."""
    noise: Array
    """How far slightly disturbed commands move the reference engine's tip, shape (T, N)."""

    @property
    def reference(self) -> str:
        """The engine that the others are compared with."""
        return next(iter(self.tips))

    @property
    def noise_floor(self) -> float:
        """The mean of `noise` over each episode and then over episodes."""
        return float(np.nanmean(self.noise, axis=0).mean())

    def errors(self, engine: str) -> Array:
        """Return the distances from the limit, means over each episode and then over episodes,
        shape (R,)."""
        distance = np.linalg.norm(self.tips[engine] - self.limit, axis=-1)
        return np.nanmean(distance, axis=1).mean(axis=1)

    def order(self, engine: str) -> float:
        """Return the power of the time step that fits the errors best."""
        return float(np.polyfit(np.log(self.time_steps), np.log(self.errors(engine)), 1)[0])

    def mean_distance(self, engine: str) -> Array:
        """Return the distances between the tips of an engine and of the reference, means as in
        :meth:`errors`, shape (R,)."""
        return np.nanmean(self.distance(engine), axis=1).mean(axis=1)

    def distance(self, engine: str) -> Array:
        """Return the distances between the tips of an engine and of the reference, shape (R, T,
        N)."""
        return np.linalg.norm(self.tips[engine] - self.tips[self.reference], axis=-1)

    def checks(self) -> list[Check]:
        """Check the order, that the engines have one limit, and along the demonstrator how far they
        are apart at the default time step."""
        checks = []
        for engine, place in ((name, f"{name}, {self.commands}") for name in self.tips):
            order = self.order(engine)
            checks.append(Check(3, "order", place, order, ORDER, "", at_least=True))
        own = self.errors(self.reference)[-1]
        for engine in list(self.tips)[1:]:
            pair, mean = f"{engine} - {self.reference}, {self.commands}", self.mean_distance(engine)
            if self.commands == DEMONSTRATOR:
                checks.append(Check(3, "mean tip distance", pair, float(mean[0]), DISTANCE, "m"))
            finest = "tip distance over own error at the finest step"
            checks.append(Check(3, finest, pair, float(mean[-1] / own), APART, "relative"))
        return checks

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as plain data for JSON."""
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
                "mean": self.noise_floor,
                "max": float(np.nanmax(self.noise)),
            },
        }


def refined(robot: Robot, parts: int) -> Robot:
    """Return the robot with its time step and the recovery time of its constraints divided."""
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
        engines: the engines, the reference first.
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
