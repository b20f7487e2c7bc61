"""Pictures read back."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import ImageColor


def count_pixels(path: Path, color: str) -> int:
    """Return how many pixels of a picture have exactly this colour."""
    picture: NDArray[np.uint8] = imageio.imread(path)[..., :3]
    return int((picture == ImageColor.getrgb(color)).all(axis=2).sum())
