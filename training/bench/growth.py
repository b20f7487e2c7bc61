"""How the cost of a step grows with the number of links and of segments."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from cdcsr.plots import COLORS, drawn
from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.engines import engine_title, make_simulation, principal_engines

LINKS = (6, 12, 24, 48)
SEGMENTS = (1, 2, 3, 4)


@dataclass(frozen=True)
class Growth:
    """The cost of a step of one copy, in [us], and the exponents p of its best fits size^p."""

    links: Mapping[int, float]
    """Cost by the number of links, in two segments."""
    segments: Mapping[int, float]
    """Cost by the number of segments, with twelve links in all."""
    links_exponent: float
    segments_exponent: float


def growth(robot: Robot, plot: Path | None) -> Iterator[Measurement]:
    """Measure how the cost of a step grows in every installed engine that is no variant.

    Args:
        robot: its first segment gives the parts of the robots that are measured.
        plot: folder for a figure, if any.
    """
    measured: dict[str, Growth] = {}
    for engine in principal_engines():
        cost = measured[engine] = measure_growth(robot, engine)
        for size, what, exponent, microseconds in (
            ("links", "links, 6 to 48", cost.links_exponent, cost.links),
            ("segments", "segments, 1 to 4, twelve links", cost.segments_exponent, cost.segments),
        ):
            yield Measurement(
                f"growth_{engine}_{size}",
                exponent,
                f"{engine_title(engine)}: exponent of a step's cost in {what}",
                ", ".join(f"{count}: {value:.0f} us" for count, value in microseconds.items()),
                details={f"growth_{engine}": asdict(cost)},
            )
    if plot is not None:
        draw_growth(measured, plot / "growth.png")
        print(f"        drawn to {plot / 'growth.png'}")


def measure_growth(robot: Robot, engine: str) -> Growth:
    """Measure robots of all sizes in one engine."""
    links = {links: step_seconds(resized(robot, 2, links), engine) for links in LINKS}
    segments = {count: step_seconds(resized(robot, count, 12), engine) for count in SEGMENTS}
    return Growth(
        {count: 1e6 * seconds for count, seconds in links.items()},
        {count: 1e6 * seconds for count, seconds in segments.items()},
        fitted_exponent([*links], [*links.values()]),
        fitted_exponent([*segments], [*segments.values()]),
    )


def resized(robot: Robot, segments: int, links: int) -> Robot:
    """Return a robot with this many segments and links in all, made of the parts of the first
    segment of `robot`."""
    data = robot.model_dump()
    segment = data["segments"][0]
    data["segments"] = [
        segment | {"links": len(part)} for part in np.array_split(np.arange(links), segments)
    ]
    return Robot.model_validate(data)


def step_seconds(
    robot: Robot, engine: str, copies: int = 4, steps: int = 40, rounds: int = 5, read: bool = False
) -> float:
    """Return the median processor time of a step of one copy, in [s], under gentle random commands.

    Args:
        robot: the description.
        engine: the engine.
        copies: how many copies are stepped together.
        steps: steps in each round.
        rounds: how often they are measured.
        read: also read the state after each step.
    """
    simulation = make_simulation(robot, engine, copies)
    commands = -0.2 * np.random.default_rng(0).random((steps, copies, robot.num_cables))
    simulation.step(commands[0])  # the first step may compile
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


def fitted_exponent(sizes: Sequence[int], costs: Sequence[float]) -> float:
    """Return the p of the least-squares fit of log(cost) ~ p log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def draw_growth(measured: Mapping[str, Growth], path: Path) -> None:
    """Draw the cost of a step against the size of the robot: marks measured, lines fitted.

    Args:
        measured: by engine.
        path: the PNG to write.
    """
    with drawn(path, (9.4, 4.2), "constrained") as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for (engine, cost), color in zip(measured.items(), COLORS, strict=False):
            title = engine_title(engine)
            for axes, sizes, exponent, what in (
                (left, cost.links, cost.links_exponent, "links"),
                (right, cost.segments, cost.segments_exponent, "segments"),
            ):
                _draw_fit(axes, sizes, exponent, color, f"{title}: {what}^{exponent:.2f}")
        left.set(xlabel="links, in two segments", ylabel="time of a step of one copy [µs]")
        right.set(xlabel="segments, of twelve links in all; four cables each")
        figure.suptitle("Cost of a step against the size of the robot, and its best fit by a power")


def _draw_fit(
    axes: Axes, microseconds: Mapping[int, float], exponent: float, color: str, label: str
) -> None:
    sizes, values = np.array([*microseconds]), np.array([*microseconds.values()])
    axes.plot(sizes, values, "o", color=color, markersize=6)
    scale = np.exp(np.log(values).mean() - exponent * np.log(sizes).mean())
    axes.plot(sizes, scale * sizes**exponent, color=color, linewidth=1.4, label=label)
    axes.set(xscale="log", yscale="log")
    axes.grid(True)
    axes.xaxis.set_major_locator(FixedLocator(sizes.tolist()))
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(loc="upper left")
