"""Draw what other commands measured: the transfer matrix, sweeps, and episodes over time."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from cdcsr.files import JsonObject
from cdcsr.plots import COLORS, SOFT, drawn
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import engine_title
from cdcsr.tasks.task import base_errors
from training.measure.plant_axes import AXES
from training.plots.video import Recording

_MARKERS = "os^DvP*X"


def draw_matrix(cells: Sequence[JsonObject], path: Path) -> None:
    """Draw the success of each controller in each engine and space, with its 95 % interval.

    Args:
        cells: the cells of `cdcsr transfer --json`.
        path: the file to write.
    """
    spaces, rows, engines = (
        list(dict.fromkeys(str(cell[key]) for cell in cells))
        for key in ("space", "controller", "backend")
    )
    size = 1.6 + (1.15 * len(engines) + 0.3) * len(spaces) + 1.2, 1.6 + 0.55 * len(rows)
    with drawn(path, size, "constrained") as figure:
        panels = figure.subplots(1, len(spaces), sharey=True, squeeze=False)[0]
        for axes, space in zip(panels, spaces, strict=True):
            rates = np.full((len(rows), len(engines)), np.nan)
            for cell in [cell for cell in cells if cell["space"] == space]:
                i, j = rows.index(cell["controller"]), engines.index(cell["backend"])
                rates[i, j] = cell["success_rate"]
                low, high = cell["success_low"], cell["success_high"]
                color = "white" if rates[i, j] < 0.5 else "black"
                text = f"{rates[i, j]:.2f}\n{low:.2f}–{high:.2f}"
                axes.text(j, i, text, color=color, ha="center", va="center", fontsize=8)
            # Cividis looks alike to readers with and without colour blindness.
            axes.imshow(rates, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto")
            axes.set_title(space)
            names = [textwrap.fill(engine_title(name), 10) for name in engines]
            axes.set_xticks(range(len(engines)), names, fontsize=8)
            axes.set_yticks(range(len(rows)), [textwrap.fill(name, 28) for name in rows])
            axes.tick_params(labelsize=8)
        bar = figure.colorbar(
            panels[0].images[0], ax=panels, format=PercentFormatter(1, decimals=0)
        )
        bar.set_label("success, and its 95 % interval")


def draw_sweep(points: Sequence[JsonObject], path: Path) -> None:
    """Draw success against each number of the plant, a line an engine, with its 95 % interval.

    Args:
        points: the points of `cdcsr sweep --json`.
        path: the file to write.
    """
    titles = {axis.name: axis.title for axis in AXES.values()}
    names = list(dict.fromkeys(str(point["axis"]) for point in points))
    engines = list(dict.fromkeys(str(point["backend"]) for point in points))
    columns = min(3, len(names))
    lines = -(-len(names) // columns)
    with drawn(path, (3.3 * columns + 0.5, 2.7 * lines + 0.7), "constrained") as figure:
        panels = figure.subplots(lines, columns, sharey=True, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            for n, engine in enumerate(engines):
                found = [
                    (p["level"], p["success_rate"], p["success_low"], p["success_high"])
                    for p in points
                    if p["axis"] == name and p["backend"] == engine and "success_rate" in p
                ]
                level, rate, low, high = np.array(sorted(found), dtype=float).reshape(-1, 4).T
                color = COLORS[n % len(COLORS)]
                axes.fill_between(level, low, high, color=color, alpha=0.15, lw=0)
                mark = _MARKERS[n % len(_MARKERS)]
                # Engines that agree lie on each other: the first has the largest marks.
                size, title = max(3, 9 - 3 * n), engine_title(engine)
                axes.plot(level, rate, color=color, marker=mark, ms=size, label=title)
            axes.set(xlabel=titles[name], ylim=(0, 1.02))
            axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
            axes.grid()
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        for axes in panels[::columns]:
            axes.set_ylabel("success")
        panels[0].legend(fontsize=8)


def draw_parity(parity: JsonObject, path: Path) -> None:
    """Draw how far engines are apart: after one step, and without feedback at several time steps.

    Args:
        parity: the object in the file of `cdcsr parity --json`.
        path: the file to write.
    """
    steps, loops = parity["one_step"], parity["open_loop"]
    with drawn(path, (3.6 * (1 + len(loops)) + 0.6, 4.6), "constrained") as figure:
        first, *panels = figure.subplots(1, 1 + len(loops))
        _one_step(first, steps, list(parity["engines"]))
        for axes, loop in zip(panels, loops, strict=True):
            _open_loop(axes, loop, list(parity["engines"]))
            axes.sharey(panels[0])
        panels[0].set_ylabel("tip, mean over an episode [mm]")
        for axes in (first, panels[0]):
            marks, labels = axes.get_legend_handles_labels()
            place = "outside lower left" if axes is first else "outside lower right"
            figure.legend(marks, labels, loc=place, fontsize=8, ncols=1 if axes is first else 2)
        figure.suptitle(f"{parity['robot']}: how far engines are apart")


def _one_step(axes: Axes, parts: Sequence[JsonObject], engines: Sequence[str]) -> None:
    """Draw the differences after one step, from the median to the 95th percentile, as parts of the
    quantity's own size."""
    quantities = list(parts[0]["differences"])
    for n, part in enumerate(parts):
        rows = [part["differences"][name] for name in quantities]
        size = np.array([row["size_p95"] for row in rows])
        median, high = (np.array([row[key] for row in rows]) / size for key in ("median", "p95"))
        place = np.arange(len(rows)) + 0.12 * (n - (len(parts) - 1) / 2)
        engine = engines.index(part["pair"].partition(" - ")[0])
        color, label = COLORS[engine % len(COLORS)], f"{part['pair']}, {part['commands']}"
        mark, face = _MARKERS[engine % 8], color if part["commands"] == "demonstrator" else "white"
        median, high = np.maximum([median, high], 1e-16)  # a logarithmic scale has no zero
        axes.hlines(place, median, high, color=color, lw=2)
        axes.plot(median, place, mark, color=color, mfc=face, label=label, ms=6)
    axes.set(
        xscale="log", title="after one step from one state", ylim=(len(quantities) - 0.5, -0.5)
    )
    axes.set_xlabel("difference / size; median to 95 % of states")
    axes.set_yticks(range(len(quantities)), [textwrap.fill(name, 12) for name in quantities])
    axes.grid()


def _open_loop(axes: Axes, loop: JsonObject, engines: Sequence[str]) -> None:
    """Draw each engine's error, and its distance from the first one, against the time step."""
    time = 1e3 * np.array(loop["time_steps"])
    for n, (engine, errors) in enumerate(loop["errors"].items()):
        color, mark = COLORS[n % len(COLORS)], _MARKERS[n % 8]
        # Engines that agree lie on each other: the first has the largest marks.
        size, title = max(3, 9 - 3 * n), engine_title(engine)
        error = 1e3 * np.array(errors)
        axes.plot(time, error, mark + "-", color=color, ms=size, label=f"{title}, from its limit")
        if engine in loop["tip_distance"]:
            apart = 1e3 * np.maximum(loop["tip_distance"][engine]["mean"], 1e-12)
            label = f"{title}, from {engine_title(engines[0])}"
            axes.plot(time, apart, mark + "--", color=color, ms=4, mfc="white", label=label)
    floor = 1e3 * loop["noise_floor"]["mean"]
    label = f"commands off by {loop['noise_floor']['disturbance']:g}"
    axes.axhline(floor, color=SOFT, ls=":", lw=1.2, label=label)
    axes.set(xscale="log", yscale="log", xlabel="time step [ms]")
    axes.set_xticks(time, [f"{each:g}" for each in time])
    axes.minorticks_off()
    axes.set_title(f"same commands: {loop['commands']}")
    axes.grid()


def draw_episode(recordings: Sequence[Recording], robot: Robot, period: float, path: Path) -> None:
    """Draw distance, travel, tension and the base's motion over time, a column an engine.

    Args:
        recordings: one episode in each engine.
        robot: the description.
        period: time between two rows of a recording, in [s].
        path: the file to write.
    """
    num = robot.num_cables
    with drawn(path, (4.2 * len(recordings) + 1.6, 9.0), "constrained") as figure:
        panels = figure.subplots(5, len(recordings), sharex=True, sharey="row", squeeze=False)
        for column, recording in zip(panels.T, recordings, strict=True):
            end = int(recording.end[0]) + 1
            time, position = period * np.arange(end), recording.position[:end, 0]
            _, tilt = base_errors(position[:, :3], position[:, 3:7])
            shift = 1e3 * (position[:, :3] - position[0, :3])
            cables = [f"cable {n + 1}" for n in range(num)]
            column[0].set_title(engine_title(recording.backend))
            distance = 1e3 * recording.distance[:end, :1]
            _lines(column[0], time, distance, [], "tip to target [mm]")
            _lines(column[1], time, 1e3 * position[:, 7 : 7 + num], cables, "travel [mm]")
            _lines(column[2], time, recording.tension[:end, 0], cables, "tension [N]")
            _lines(column[3], time, shift, ["x", "y", "z"], "base moved by [mm]")
            _lines(column[4], time, np.rad2deg(tilt)[:, None], [], "base turned by [deg]")
            column[4].set_xlabel("time [s]")
        for axes in panels[1:4, -1]:
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)


def _lines(
    axes: Axes, time: np.ndarray, values: np.ndarray, labels: Sequence[str], title: str
) -> None:
    """Draw columns of `values`, shape (T, n), over time."""
    dashes = "-", "--", ":"
    for n, series in enumerate(values.T):
        style = dashes[n // len(COLORS) % len(dashes)]
        label = labels[n] if labels else None
        axes.plot(time, series, style, color=COLORS[n % len(COLORS)], lw=1.3, label=label)
    axes.axhline(0.0, color=SOFT, lw=0.7, zorder=0)
    axes.grid()
    if axes.get_subplotspec().is_first_col():  # pyright: ignore[reportOptionalMemberAccess]
        axes.set_ylabel(title)
