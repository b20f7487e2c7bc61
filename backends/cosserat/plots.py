"""Draw how far rods of links are from continuous ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from backends.cosserat.reference import Release
from backends.cosserat.releases import Swing
from backends.cosserat.statics import Fit
from cdcsr.plots import COLORS, INK, SOFT, drawn

_ROUNDED = 0.1
"""The data's places are rounded to this, in [mm]."""
_SECONDS = 3.0
"""How much of a release is drawn, in [s]."""


def draw(
    fits: Mapping[str, Sequence[Fit]], moving: tuple[Release, Swing, Swing] | None, path: Path
) -> None:
    """Draw the tip error of shapes at rest by the number of links, and one release.

    Args:
        fits: by material.
        moving: a release, the motion of our rod, and that of a stacked one; or None.
        path: the PNG to write.
    """
    with drawn(path, (9.4, 3.6), "constrained") as figure:
        panels = figure.subplots(1, 2 if moving else 1, squeeze=False)[0]
        axes = panels[0]
        counts = sorted({fit.links for found in fits.values() for fit in found})
        for color, (material, found) in zip(COLORS, fits.items(), strict=False):
            for parity, marker in ((0, "o"), (1, "D")):
                chosen = sorted(
                    (f.links, 1e3 * f.tip_error.mean()) for f in found if f.links % 2 == parity
                )
                if chosen:
                    label = f"{material}, {('even', 'odd')[parity]}"
                    axes.plot(*zip(*chosen, strict=True), marker=marker, color=color, label=label)
        largest = max(1e3 * f.tip_error.mean() for found in fits.values() for f in found)
        slope = largest * (counts[0] / np.array(counts, dtype=float)) ** 2
        axes.plot(counts, slope, color=SOFT, linestyle="--", label="second order")
        axes.axhline(_ROUNDED, color=SOFT, linestyle=":", label="rounding of the data")
        axes.set(xscale="log", yscale="log", xlabel="links", ylabel="mean tip error [mm]")
        axes.xaxis.set_major_locator(FixedLocator(counts))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_title("Shapes at rest")
        axes.grid()
        axes.legend(fontsize=8, loc="lower left")
        if moving:
            release, ours, stacked = moving
            seconds = release.interval * np.arange(len(release.tip))
            shown = seconds <= _SECONDS
            # across the rod, in the direction in which the tip moves most
            x = int(np.argmax(np.ptp(release.tip[:, :2], axis=0)))
            lines = (
                ("continuous rod", release.tip, INK, "-", 2.4),
                ("joints in the middle of cells", ours.tip, COLORS[1], "--", 1.4),
                ("joints at the start of cells", stacked.tip, COLORS[0], ":", 1.4),
            )
            for label, tip, color, style, width in lines:
                values = 1e3 * tip[shown, x]
                panels[1].plot(
                    seconds[shown], values, style, color=color, linewidth=width, label=label
                )
            panels[1].set(xlabel="time [s]", ylabel="tip, across the rod [mm]")
            panels[1].set_title("A release")
            panels[1].grid()
            panels[1].legend(fontsize=8, loc="lower right")
