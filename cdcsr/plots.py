"""How figures look: Matplotlib's settings and colours, as plain data."""

from __future__ import annotations

from typing import Any

INK, SOFT = "#333333", "#999999"
"""Of text, and of what should not stand out."""
STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
}
GRID_STYLE: dict[Any, Any] = {**STYLE, "font.size": 9.5, "axes.grid": True, "axes.axisbelow": True}
"""Of figures of engines."""
