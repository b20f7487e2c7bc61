"""Level 3: the same commands without feedback, while the time step is halved again and again.

An engine converges to one motion as the step shrinks. At a given step the distance from this limit
is its own discretization error. Engines that integrate the description's ideal equation have one
limit in common. Others have limits of their own, and the distance between the limits is what their
physics differs by; one of their settings after the other is set to the description's, which shows
how much each accounts for.

By substeps, commands are held for the same time at every step size. The recovery time of the
constraints shrinks with the step: it says how fast an engine takes back what a step let through, so
it is a part of the discretization, and the limit is the ideal cable, which is never longer than at
rest. A fixed recovery time would be a property of the material. MuJoCo would read it as a
critically damped spring, and a complementarity problem as a rate, and each engine would converge to
its own cable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from backends.parity.checks import Check, Engines, reference_of
from backends.parity.trajectories import DEMONSTRATOR, Commands, random_commands
from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Array, Simulation

REFINEMENTS = (1, 2, 4, 8)
"""Into how many parts the time step is divided, one refinement after the other. The limit is
extrapolated from the last two."""
DISTANCE = 2e-3
"""The largest allowed mean distance of the tips over demonstrator episodes at the default time
step, as a part of the arm's length."""
ORDER = 0.8
"""Errors must shrink with at least this power of the time step. Semi-implicit Euler is of first
order; the order of an engine that converges to nothing falls to zero."""
APART = 0.1
"""The largest allowed distance between the limits of ideal engines, as a part of the larger error
at the default time step."""
_ROUNDING = 1e-12
"""Smaller motions, as a part of the arm's length, tell no order."""
DISTURBANCE = 1e-6
"""The standard deviation of the noise on the commands of the disturbed run, as a part of their
range."""


@dataclass(frozen=True)
class OpenLoop:
    """The tips in R refinements at T instants in N episodes. Lengths are in [m]; entries after an
    episode's end are NaN."""

    commands: str
    time_steps: Array
    """In [s], shape (R,)."""
    time: Array
    """In [s], shape (T,)."""
    tips: dict[str, Array]
    """The positions by engine, the reference first, shape (R, T, N, 3)."""
    noise: Array
    """How far slightly disturbed commands move the reference engine's tip, shape (T, N)."""
    ideal: frozenset[str]
    """The engines that integrate the description's ideal equation."""
    switches: dict[str, Array]
    """How far the tip moves at the default time step when one setting of an engine is set to the
    description's, by the engine's name with this option, shape (T, N)."""
    arm_length: float

    @property
    def reference(self) -> str:
        """The engine that the others are compared with."""
        return next(iter(self.tips))

    @property
    def noise_floor(self) -> float:
        """The mean of `noise` over each episode and then over episodes."""
        return float(_mean(self.noise))

    def limit(self, engine: str) -> Array:
        """Return the position to which the tip converges, to second order, shape (T, N, 3)."""
        return 2 * self.tips[engine][-1] - self.tips[engine][-2]

    def errors(self, engine: str) -> Array:
        """Return the distances from the engine's own limit, means over each episode and then over
        episodes, shape (R,)."""
        return _mean(np.linalg.norm(self.tips[engine] - self.limit(engine), axis=-1))

    def accurate_step(self, engine: str, error: float) -> float:
        """Return the time step in [s] at which the engine's mean error would be `error`, in [m];
        the error is of first order."""
        return float(self.time_steps[0] * error / self.errors(engine)[0])

    def limit_distance(self, engine: str) -> float:
        """Return the distance from the reference's limit to an engine's, a mean as in
        :meth:`errors`."""
        apart = self.limit(engine) - self.limit(self.reference)
        return float(_mean(np.linalg.norm(apart, axis=-1)))

    def order(self, engine: str) -> float:
        """Return the power p of the time step with which refinements move the tip less and less.

        Each instant of each episode is fitted by a h^p with a factor a of its own: p is the slope
        of the mean logarithm. A mean of lengths would be that of the few largest: where
        `hanging-arm` bends to soft limits, errors grow a thousandfold, and how much they grow
        itself changes with the step. There it finds 0.6 to 1.3 by the seed, and this 0.96 to 1.08.
        """
        moved = np.linalg.norm(np.diff(self.tips[engine], axis=0), axis=-1)
        known = (moved > _ROUNDING * self.arm_length).all(axis=0)  # not NaN either
        logarithms = np.log(moved[:, known]).mean(axis=1)
        return float(np.polyfit(np.log(self.time_steps[:-1]), logarithms, 1)[0])

    def mean_distance(self, engine: str) -> Array:
        """Return the distances between the tips of an engine and of the reference, means as in
        :meth:`errors`, shape (R,)."""
        return _mean(self.distance(engine))

    def distance(self, engine: str) -> Array:
        """Return the distances between the tips of an engine and of the reference, shape (R, T,
        N)."""
        return np.linalg.norm(self.tips[engine] - self.tips[self.reference], axis=-1)

    def checks(self) -> list[Check]:
        """Check the order of every engine, and of ideal engines that they have one limit, and along
        the demonstrator how far they are apart at the default time step."""
        checks = []
        for engine, place in ((name, f"{name}, {self.commands}") for name in self.tips):
            order = self.order(engine)
            checks.append(Check(3, "order", place, order, ORDER, "", at_least=True))
        for engine in [
            name for name in list(self.tips)[1:] if {name, self.reference} <= self.ideal
        ]:
            pair = f"{engine} - {self.reference}, {self.commands}"
            if self.commands == DEMONSTRATOR:
                mean, most = float(self.mean_distance(engine)[0]), DISTANCE * self.arm_length
                checks.append(Check(3, "mean tip distance", pair, mean, most, "m"))
            error = max(self.errors(name)[0] for name in (engine, self.reference))
            apart = self.limit_distance(engine) / error
            checks.append(Check(3, "limits apart", pair, float(apart), APART, "of the error"))
        return checks

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as plain data for JSON."""
        return {
            "commands": self.commands,
            "episodes": self.noise.shape[1],
            "time_steps": self.time_steps.tolist(),
            "errors": {engine: self.errors(engine).tolist() for engine in self.tips},
            "order": {engine: self.order(engine) for engine in self.tips},
            "tip_distance": {
                engine: {
                    "mean": self.mean_distance(engine).tolist(),
                    "max": np.nanmax(self.distance(engine), axis=(1, 2)).tolist(),
                    "limits": self.limit_distance(engine),
                }
                for engine in list(self.tips)[1:]
            },
            "ideal": sorted(self.ideal),
            "switches": {
                name: {"mean": float(_mean(moved)), "max": float(np.nanmax(moved))}
                for name, moved in self.switches.items()
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
    switches: Mapping[str, Engines] | None = None,
) -> OpenLoop:
    """Run all engines under the same commands at every refinement.

    Args:
        robot: the description.
        engines: the engines, the reference first.
        commands: one for each default time step.
        progress: called with the number of simulation steps just made.
        switches: by engine, the same engine with one setting set to the description's.
    """

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

    first = reference_of(engines)
    tips = {
        name: np.stack([run(make, parts) for parts in REFINEMENTS])
        for name, make in engines.items()
    }
    disturbance = (
        DISTURBANCE
        * np.abs(robot.full_commands)
        * np.random.default_rng(0).normal(size=commands.values.shape)
    )
    disturbed = run(engines[first], 1, commands.values + disturbance)
    moved = {
        name: np.linalg.norm(run(make, 1) - tips[engine][0], axis=-1)
        for engine, others in (switches or {}).items()
        for name, make in others.items()
    }
    return OpenLoop(
        commands=commands.name,
        time_steps=robot.time_step / np.array(REFINEMENTS),
        time=robot.time_step * np.arange(1, commands.values.shape[1] + 1),
        tips=tips,
        noise=np.linalg.norm(disturbed - tips[first][0], axis=-1),
        ideal=frozenset(name for name, make in engines.items() if _is_ideal(make(robot, 1))),
        switches=moved,
        arm_length=robot.arm_length,
    )


def accuracy(robot: Robot) -> float:
    """Return an error of the tip that hardly matters to a task, in [m]: a tenth of the robot's own
    threshold."""
    return ruler(robot).threshold / 10


def accurate_step(
    robot: Robot, make: Callable[[Robot, int], Simulation], error: float
) -> float | None:
    """Estimate the time step at which the mean error of the tip is `error`, under random commands.

    A first-order method's error at a step h is twice the distance from the motion at h / 2. Two
    runs take little time; :meth:`OpenLoop.accurate_step` measures the same from a limit.

    Args:
        robot: the description.
        make: makes simulations in an engine.
        error: in [m].

    Returns:
        The time step in [s]; None if the engine diverges at the robot's own.
    """
    commands = random_commands(robot, 2, seed=0).values.swapaxes(0, 1)
    tips = []
    for parts in (1, 2):
        simulation = make(refined(robot, parts), commands.shape[1])
        try:
            for command in commands:
                simulation.step(command, parts)
                tips.append(simulation.state().tip_position)
        except Diverged:
            return None
        finally:
            simulation.close()
    coarse, fine = np.split(np.array(tips), 2)
    return float(robot.time_step * error / (2 * np.linalg.norm(coarse - fine, axis=-1).mean()))


def _is_ideal(simulation: Simulation) -> bool:
    simulation.close()
    return simulation.ideal


def _mean(values: Array) -> Array:
    """Average over an episode, and then over episodes; both are the last axes, and what lies after
    an episode's end is NaN."""
    return np.nanmean(values, axis=-2).mean(axis=-1)
