"""What is sent now and arrives some whole number of steps later."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError

Array = NDArray[np.float64]

MAX_DELAY = 100
"""Longest delay in steps: a quarter of a second at 400 Hz, and 0.8 kB of memory for each of a copy's cables."""


def check_delay(name: str, delay: object) -> NDArray[np.int64]:
    """A delay, or several, as whole numbers.

    Raises:
        CdcsrError: not whole numbers from 0 to `MAX_DELAY`.
    """
    steps = np.asarray(delay)
    if steps.dtype.kind not in "iu" or ((steps < 0) | (steps > MAX_DELAY)).any():
        raise CdcsrError(f"{name} counts whole steps, from 0 to {MAX_DELAY}; found {delay!r}.")
    return steps.astype(np.int64)


class DelayLine:
    """Rows under way to `num` copies, each copy with a delay of its own; zeros arrive before the first ones sent.

    Args:
        num: how many copies.
        width: numbers in a row.
    """

    def __init__(self, num: int, width: int) -> None:
        self._delay = np.zeros(num, np.int64)
        self._every = np.arange(num)
        self._sent = np.zeros((num, 0, width))

    @property
    def sent(self) -> Array:
        """The rows last sent, oldest first, shape (num, longest delay, width)."""
        return self._sent.copy()

    @sent.setter
    def sent(self, rows: Array) -> None:
        """What is not needed is dropped, and what is missing is zero."""
        num, longest, width = self._sent.shape
        kept = min(longest, rows.shape[1])
        self._sent = np.zeros((num, longest, width))
        self._sent[:, longest - kept :] = rows[:, rows.shape[1] - kept :]

    @property
    def idle(self) -> bool:
        """Whether all rows arrive at once, so that there is no need to push them through."""
        return self._sent.shape[1] == 0

    def set_delay(self, ids: NDArray[np.int64], delay: NDArray[np.int64]) -> None:
        """From now on rows to copies `ids` arrive `delay` steps late; the others' are as late as before."""
        self._delay[ids] = delay
        rows = self._sent
        self._sent = np.zeros((rows.shape[0], int(self._delay.max()), rows.shape[2]))
        self.sent = rows

    def fill(self, ids: NDArray[np.int64], row: Array) -> None:
        """As if `row`, shape (len(ids), width), had been sent to copies `ids` for ever."""
        self._sent[ids] = row[:, None]

    def push(self, row: Array) -> Array:
        """Send a row to each copy, shape (num, width); returns those that arrive, of the same shape."""
        line = np.concatenate([self._sent, row[:, None]], axis=1)
        self._sent = line[:, 1:]
        return line[self._every, self._sent.shape[1] - self._delay]
