"""The one style of all figures, and the one way to draw a figure into a file.

Matplotlib is imported here, so import this module only where figures are drawn.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from cdcsr.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

INK, SOFT = "#333333", "#999999"
"""Colours of text, and of lines that should not stand out."""
COLORS = ("#1f5fa8", "#d9822b", "#7b4fa3", "#2f8f83", "#a23b5c", "#6b6b6b", "#8a7a1f", "#4a9bd4")
"""Colours of curves, in the order in which they are used."""
_STYLE: dict[RcKeyType, object] = {
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.axisbelow": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
}
_DPI = 160


@contextmanager
def drawn(
    path: Path, size: tuple[float, float], layout: Literal["constrained"] | None = None
) -> Iterator[Figure]:
    """Yield an empty figure, and write it as a PNG or, if the path ends so, a PDF when the block
    ends.

    The figure belongs to no window and to no global state, so no display is needed.

    Args:
        path: the file to write.
        size: width and height in inches, before the margins are cut.
        layout: Matplotlib's layout engine; "constrained" suits grids of panels.

    Raises:
        CdcsrError: the file cannot be written.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size, layout=layout)
        yield figure
        data = io.BytesIO()
        pdf = path.suffix == ".pdf"
        kind = "pdf" if pdf else "png"
        figure.savefig(data, format=kind, dpi=_DPI, bbox_inches="tight", pad_inches=0.08)
    write_bytes(path, data.getvalue() if pdf else _with_palette(data))


def _with_palette(png: io.BytesIO) -> bytes:
    """Return a picture in its 256 most frequent colours, in a third of the bytes."""
    small = io.BytesIO()
    picture = Image.open(png).convert("RGB")
    picture.quantize(256, dither=Image.Dither.NONE).save(small, format="png", optimize=True)
    return small.getvalue()


def short_count(value: float, _: object = None) -> str:
    """Format a number for an axis: 1,500,000 as 1.5M, 2,000 as 2k."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"
