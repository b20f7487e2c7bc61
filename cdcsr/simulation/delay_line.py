"""Delays by a whole number of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError

Array = NDArray[np.float64]

MAX_DELAY = 100
"""The longest delay, in steps: a quarter of a second at 400 Hz. It takes 0.8 kB for each cable of
each copy."""


def check_delay(name: str, delay: object) -> NDArray[np.int64]:
    """Return one delay or several as whole numbers.

    Args:
        name: what the delay is called in the error.
        delay: in steps.

    Raises:
        CdcsrError: they are not whole numbers from 0 to `MAX_DELAY`.
    """
    steps = np.asarray(delay)
    if steps.dtype.kind not in "iu" or ((steps < 0) | (steps > MAX_DELAY)).any():
        raise CdcsrError(f"{name} counts whole steps, from 0 to {MAX_DELAY}; found {delay!r}.")
    return steps.astype(np.int64)


class DelayLine:
    """Rows of numbers on their way to `num` copies, each copy with its own delay.

    Zeros arrive before the first row that was sent.

    Args:
        num: how many copies.
        width: how many numbers a row has.
    """

    def __init__(self, num: int, width: int) -> None:
        self._delay = np.zeros(num, np.int64)
        self._every = np.arange(num)
        self._sent = np.zeros((num, 0, width))

    @property
    def sent(self) -> Array:
        """The rows sent last, oldest first, shape (num, longest delay, width)."""
        return self._sent.copy()

    @sent.setter
    def sent(self, rows: Array) -> None:
        """Set the rows sent last; rows that are too old are dropped, missing ones are zero."""
        num, longest, width = self._sent.shape
        kept = min(longest, rows.shape[1])
        self._sent = np.zeros((num, longest, width))
        self._sent[:, longest - kept :] = rows[:, rows.shape[1] - kept :]

    @property
    def idle(self) -> bool:
        """Whether all rows arrive at once, so that nothing has to be pushed."""
        return self._sent.shape[1] == 0

    def set_delay(self, ids: NDArray[np.int64], delay: NDArray[np.int64]) -> None:
        """Delay the rows to copies `ids` by `delay` steps from now on; other copies keep theirs."""
        self._delay[ids] = delay
        rows = self._sent
        self._sent = np.zeros((rows.shape[0], int(self._delay.max()), rows.shape[2]))
        self.sent = rows

    def fill(self, ids: NDArray[np.int64], row: Array) -> None:
        """Act as if `row`, shape (len(ids), width), had always been sent to copies `ids`."""
        self._sent[ids] = row[:, None]

    def push(self, row: Array) -> Array:
        """Send a row to each copy, shape (num, width), and return the rows that arrive."""
        line = np.concatenate([self._sent, row[:, None]], axis=1)
        self._sent = line[:, 1:]
        return line[self._every, self._sent.shape[1] - self._delay]
