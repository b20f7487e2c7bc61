"""Checks of what callers hand to a simulation or to an environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.compiled import compiled
from cdcsr.errors import CdcsrError
from cdcsr.memory import check_memory

Array = NDArray[np.float64]

MOST_COPIES = 100_000
"""The largest number of copies of a robot in one simulation."""
MOST_SKIP = 10_000_000
"""The largest number of simulation steps for which an action is held."""
MOST_SEED = 2**63 - 1
"""The largest seed."""
_LARGEST_COMMAND = 1e9
"""The largest command in [m]. MuJoCo ignores commands beyond 1e10."""


def check_count(name: str, found: object, most: int, least: int = 1) -> None:
    """Check that a number is whole and in range.

    Raises:
        CdcsrError: it is not.
    """
    if (
        isinstance(found, bool)
        or not isinstance(found, int | np.integer)
        or (not least <= found <= most)
    ):
        raise CdcsrError(f"{name} must be a whole number from {least} to {most}, not {found!r}.")


def check_copies(num: int, engine: str, memory: float, free: float | None = None) -> None:
    """Check that a number of copies is in range, and that they fit into memory.

    Args:
        num: how many copies.
        engine: the engine's name.
        memory: about how much memory a copy takes there, in bytes.
        free: how many bytes there are; None for what this process may still take.

    Raises:
        CdcsrError: they do not.
    """
    check_count("The number of copies", num, MOST_COPIES)
    needed = memory * num
    remedy = "take fewer copies or episodes at a time"
    check_memory(f"{num} copies in {engine}", needed, remedy, free)


def check_number(name: str, found: float, low: float, high: float) -> None:
    """Check that a number lies in a range whose ends belong to it; NaN does not.

    Raises:
        CdcsrError: it does not.
    """
    if not low <= found <= high:
        raise CdcsrError(f"{name} must be a number from {low:g} to {high:g}, not {found:g}.")


def as_floats(
    name: str, found: object, shape: tuple[int, ...], finite: bool = True, kinds: str = ""
) -> Array:
    """Return an array of exactly the shape that is asked for.

    Args:
        name: what it is, for the error.
        found: what the caller gave.
        shape: the shape; -1 stands for one or more rows.
        finite: whether all numbers must be finite.
        kinds: kinds of NumPy types that may be, besides floats and integers.

    Raises:
        CdcsrError: it holds no real numbers, has another shape, or is not finite.
    """
    array = np.asarray(found) if not isinstance(found, list | tuple) else _from_list(name, found)
    if array.dtype.kind not in "fiu" + kinds:
        raise CdcsrError(f"{name} must be an array of numbers, not of {array.dtype}.")
    fits = len(array.shape) == len(shape) and all(
        have == want or (want == -1 and have > 0)
        for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = str(shape).replace("-1", "n")
        raise CdcsrError(f"{name} must have the shape {wanted}, not {array.shape}.")
    array = array.astype(np.float64, copy=False)
    if finite and not np.isfinite(array).all():
        raise CdcsrError(f"{name} must be finite, found {array[~np.isfinite(array)][0]}.")
    return array


def _from_list(name: str, found: object) -> NDArray[np.generic]:
    try:
        return np.asarray(found)
    except (TypeError, ValueError):
        raise CdcsrError(
            f"{name} must be an array of numbers; its rows differ in length."
        ) from None


def as_command(command: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return commands in [m] as a contiguous array of the shape (num, cables).

    Raises:
        CdcsrError: they have another shape, are not finite, or are larger than any engine takes.
    """
    if isinstance(command, np.ndarray) and command.dtype == np.float64 and command.shape == shape:
        rows = command  # so in nearly all steps, which should not pay for the whole check
    else:
        rows = as_floats("Commands", command, shape, finite=False)
    rows = np.ascontiguousarray(rows)
    # NaN, which some engines read as no command, is not below.
    if not _all_at_most(rows, _LARGEST_COMMAND):
        good = (np.abs(rows) <= _LARGEST_COMMAND).all(axis=1)
        copy = int(np.flatnonzero(~good)[0])
        raise CdcsrError(
            f"Commands must be finite and at most {_LARGEST_COMMAND:g} m; that of copy {copy} is "
            f"{rows[copy].tolist()}."
        )
    return rows


@compiled()
def _all_at_most(rows: Array, most: float) -> bool:
    """Whether no number is larger than `most` or missing. NumPy takes fifteen times as long."""
    for row in rows:
        for value in row:
            if not abs(value) <= most:
                return False
    return True


def chosen_copies(ids: object, num: int) -> NDArray[np.int64]:
    """Return the indices of the copies that a caller means.

    Args:
        ids: sorted unique indices, a mask of shape (num,), or None for all copies.
        num: how many copies there are.

    Raises:
        CdcsrError: ids are anything else.
    """
    if ids is None:
        return np.arange(num)
    found = np.asarray(ids)
    if found.dtype == np.bool_ and found.shape == (num,):
        return np.flatnonzero(found)
    if found.ndim == 1 and not len(found):
        return np.zeros(0, np.int64)
    if (
        found.ndim != 1
        or found.dtype.kind not in "iu"
        or not 0 <= found[0] <= found[-1] < num
        or not (found[1:] > found[:-1]).all()
    ):
        raise CdcsrError(
            f"ids must be sorted unique indices from 0 to {num - 1}, or a mask of shape ({num},), "
            f"not {ids!r}."
        )
    return found.astype(np.int64)
