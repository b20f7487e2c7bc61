"""What all figures share: names as they are written in text, colours, and a figure that ends as a file."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from cdcsr.files import write_bytes
from cdcsr.plots import STYLE

ALGORITHMS = {
    "bc": "BC",
    "batd3": "BATD3",
    "clasp": "CLASP (ours)",
    "td3wd": "TD3wD",
    "rbl": "RBL",
    "td3": "TD3",
    "her": "TD3+HER",
    "rlpd": "RLPD",
    "drldr": "DRLDR",
    "batd3-no-bc": "BATD3 without BC assistance",
    "batd3-no-prefill": "BATD3 without pre-filled data",
    "batd3-no-ensemble": "BATD3 without ensemble",
    "jacobian": "demonstrator",
}
"""Titles of algorithms by their names, in the order tables list them."""
ENGINES = {"mujoco": "MuJoCo", "pybullet": "PyBullet"}

RUN_COLORS = (
    "#1f5fa8",
    "#d9822b",
    "#7b4fa3",
    "#2f8f83",
    "#a23b5c",
    "#6b6b6b",
    "#8a7a1f",
    "#4a9bd4",
)
PALE = "#c9ccd1"
_DPI = 160


def algorithm_title(name: str) -> str:
    """An algorithm's name as it is written in text."""
    return ALGORITHMS.get(name, name)


def engine_title(name: str) -> str:
    """An engine's name as it is written in text."""
    return ENGINES.get(name, name)


def short_count(value: float, _: float) -> str:
    """1500000 as 1.5M; for an axis' ticks."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"


@contextmanager
def drawn(path: Path, size: tuple[float, float], layout: Any = None) -> Iterator[Figure]:
    """A figure that is written as a PNG when the block ends. It belongs to no window and no global state.

    Args:
        path: the PNG.
        size: width and height before margins are cut, in inches.
        layout: Matplotlib's layout engine, "constrained" for grids of panels.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout=layout)
        yield figure
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=_DPI, bbox_inches="tight", pad_inches=0.08)
        write_bytes(path, data.getvalue())
