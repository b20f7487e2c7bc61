"""`cdcsr workspace`: map a robot's workspace."""

from __future__ import annotations

import sys
from pathlib import Path

_MOST_POINTS = 500
"""The largest number of points along an axis of the grid, from end to end of all that an arm of the
robot's length could reach."""


def workspace(
    robot: str,
    /,
    *,
    out: Path,
    spacing: float | None = None,
    backend: str = "mujoco",
    frame_skip: int | None = None,
    threshold: float | None = None,
    seconds: float | None = None,
    plot: Path | None = None,
    json: Path | None = None,
) -> None:
    """Map the points around the arm that the scripted demonstrator reaches in an episode.

    The map is an operation space: give its file as --space to other commands. While it is made, its
    record lies beside it, and the same command goes on from there after a break. The total that is
    shown grows as neighbours of reached targets are found.

    Args:
        robot: a shipped robot's name, or a path ending in .toml.
        out: the map, an .npz file.
        spacing: the distance between the targets of the grid that are tried, in m; by default the
            robot's own, 0.05 for the paper's robot.
        backend: the engine.
        frame_skip: how many simulation steps each command is held for; fewer take longer. By
            default five times the robot's own number, 5 for the paper's robot.
        threshold: the tip is on the target within this distance, in m; by default the robot's own.
        seconds: how long an episode may take, in s; by default the robot's own.
        plot: also draw the map into this PNG file.
        json: also write the summary to this file.
    """
    from cdcsr.files import write_json
    from cdcsr.robot.description import load_robot
    from cdcsr.robot.ruler import ruler
    from cdcsr.simulation.arguments import check_number
    from cdcsr.tasks.feasible import adjusted
    from controllers.workspace import compute_workspace, draw_workspace

    _check_outputs(out, plot)
    description = adjusted(load_robot(robot), "reach", [], threshold, seconds)
    spacing = ruler(description).spacing if spacing is None else spacing
    frame_skip = 5 * ruler(description).frame_skip if frame_skip is None else frame_skip
    reach = 2 * (description.top + description.arm_length)
    check_number("spacing", spacing, reach / _MOST_POINTS, reach)
    record = out.with_name(out.name + ".part")
    if record.exists():
        print(f"going on from {record}", flush=True)
    counts = {"tried": 0, "reached": 0, "diverged": 0}
    start, end = ("\r", "") if sys.stdout.isatty() else ("", "\n")

    def progress(tried: int, found: int, reached: int, diverged: int) -> None:
        counts.update(tried=tried, reached=reached, diverged=diverged)
        print(f"{start}{tried} of {found} targets tried, {reached} reached", end=end, flush=True)

    found = compute_workspace(description, backend, spacing, frame_skip, progress, record)
    print(end="" if end else "\n")
    if counts["diverged"]:
        print(f"{counts['diverged']} episodes diverged; their targets count as not reached")
    found.save(out)
    record.unlink(missing_ok=True)
    print(f"{len(found.cells)} cells of edge {spacing:g} m around {description.name} -> {out}")
    if plot is not None:
        draw_workspace(found, description, plot)
    if json is not None:
        summary = {
            "out": str(out),
            "robot": description.name,
            "backend": backend,
            "spacing": spacing,
            **counts,
        }
        write_json(json, {**summary, "cells": len(found.cells)})


def _check_outputs(out: Path, plot: Path | None) -> None:
    """Check before the work that its files have the right ending and can be written."""
    from cdcsr.errors import CdcsrError
    from cdcsr.files import refuse_unwritable

    if out.suffix != ".npz":
        raise CdcsrError(f"A map is an .npz file, not {out.name!r}.")
    if plot is not None and plot.suffix != ".png":
        raise CdcsrError(f"The picture of a map is a .png file, not {plot.name!r}.")
    for path in (out, plot):
        if path is not None:
            refuse_unwritable(path)
