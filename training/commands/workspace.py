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
    spacing: float = 0.05,
    backend: str = "mujoco",
    frame_skip: int = 5,
    plot: Path | None = None,
    json: Path | None = None,
) -> None:
    """Map the points around the arm that the scripted demonstrator reaches in an episode.

    The map is an operation space: give its file as --space to other commands.

    Args:
        robot: a shipped robot's name, or a path ending in .toml.
        out: the map, an .npz file.
        spacing: the distance between the targets of the grid that are tried, in m.
        backend: the engine.
        frame_skip: how many simulation steps each command is held for; fewer take longer.
        plot: also draw the map into this PNG file.
        json: also write the summary to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import refuse_unwritable, write_json
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.arguments import check_number
    from controllers.workspace import compute_workspace, draw_workspace

    if out.suffix != ".npz":
        raise CdcsrError(f"A map is an .npz file, not {out.name!r}.")
    if plot is not None and plot.suffix != ".png":
        raise CdcsrError(f"The picture of a map is a .png file, not {plot.name!r}.")
    for path in (out, plot):
        if path is not None:
            refuse_unwritable(path)
    description = load_robot(robot)
    reach = 2 * (description.top + description.arm_length)
    check_number("spacing", spacing, reach / _MOST_POINTS, reach)
    counts = {"tried": 0, "reached": 0, "diverged": 0}
    start, end = ("\r", "") if sys.stdout.isatty() else ("", "\n")

    def progress(tried: int, reached: int, diverged: int) -> None:
        counts.update(tried=tried, reached=reached, diverged=diverged)
        print(f"{start}{tried} targets tried, {reached} reached", end=end, flush=True)

    found = compute_workspace(description, backend, spacing, frame_skip, progress)
    print(end="" if end else "\n")
    if counts["diverged"]:
        print(f"{counts['diverged']} episodes diverged; their targets count as not reached")
    found.save(out)
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
