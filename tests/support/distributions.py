"""Statistical tests of random draws; with fixed seeds, a test always passes or always fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

LEAST_P = 1e-4
"""A test passes above this p-value."""


def is_uniform(values: Array, low: float = 0.0, high: float = 1.0) -> bool:
    """Return whether values may come from a uniform distribution (Kolmogorov-Smirnov test)."""
    return float(stats.kstest(values, "uniform", args=(low, high - low)).pvalue) > LEAST_P


def is_isotropic(vectors: Array) -> bool:
    """Return whether the directions of vectors, shape (n, 3), may be uniform on the sphere.

    Then each coordinate is uniform (Archimedes), and coordinates are uncorrelated.
    """
    direction = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    correlation = np.abs(np.corrcoef(direction.T) - np.eye(3)).max()
    uniform = all(is_uniform(direction[:, axis], -1, 1) for axis in range(3))
    return uniform and bool(correlation < 4 / np.sqrt(len(direction)))
