"""Random numbers for runs side by side: each run draws what it would draw alone.

A generator of a library draws one sequence for a whole tensor; then a run would depend on those
beside it. Here a number is a function of the run's key and of how many it has drawn, so that all
runs are computed at once, a processor and a graphics card draw the same, and the state is one
counter, which a CUDA graph advances as it replays.

The function is SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number
generators", fig. 16), whose n-th number needs no other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor

_GOLDEN = 0x9E3779B97F4A7C15 - 2**64  # as signed integers, which wrap alike
_FIRST, _SECOND = 0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64
_DIGITS = 23
"""Binary digits of a number from 0 to 1; float32 holds one more, for the half that is added."""


class Streams:
    """A sequence of random numbers for each of S runs.

    Args:
        keys: one for each run, whole numbers of 64 bits.
        device: where the numbers are needed.

    Attributes:
        drawn: how many numbers each run has drawn, an integer tensor of shape ().
    """

    def __init__(self, keys: Sequence[int], device: torch.device) -> None:
        signed = [key - 2**64 if key >= 2**63 else key for key in keys]
        self._keys = torch.tensor(signed, dtype=torch.int64, device=device)[:, None]
        self.drawn = torch.zeros((), dtype=torch.int64, device=device)
        self._sizes: dict[str, int] = {}
        self._ahead: Tensor | None = None
        self._taken = 0

    @contextmanager
    def together(self, work: str) -> Iterator[None]:
        """Find the numbers that a piece of work draws all at once, from its second time on.

        They are the same ones. A number takes 15 operations, and on a GPU it is the launches that
        cost.

        Args:
            work: its name; it draws as many numbers each time.
        """
        size = self._sizes.get(work)
        self._taken, self._ahead = 0, None if size is None else self._next(size)
        try:
            yield
        finally:
            self._ahead = None
        assert size in (None, self._taken)
        self._sizes[work] = self._taken

    def bits(self, num: int) -> Tensor:
        """Return the next `num` numbers of 64 bits of every run, shape (S, num), int64."""
        first, self._taken = self._taken, self._taken + num
        return self._next(num) if self._ahead is None else self._ahead[:, first : first + num]

    def _next(self, num: int) -> Tensor:
        count = torch.arange(1, num + 1, device=self.drawn.device) + self.drawn
        self.drawn += num
        mixed = self._keys + count * _GOLDEN
        mixed = (mixed ^ _right(mixed, 30)) * _FIRST
        mixed = (mixed ^ _right(mixed, 27)) * _SECOND
        return mixed ^ _right(mixed, 31)

    def uniform(self, like: Tensor) -> Tensor:
        """Return numbers above 0 and below 1 of the shape of a tensor, (S, ...)."""
        num = math.prod(like.shape[1:])
        digits = _right(self.bits(num), 64 - _DIGITS).to(torch.float32)
        return ((digits + 0.5) / 2**_DIGITS).view(like.shape)

    def normal(self, like: Tensor) -> Tensor:
        """Return normal deviates of the shape of a tensor, (S, ...)."""
        return torch.erfinv(2 * self.uniform(like) - 1) * math.sqrt(2)

    def below(self, limit: int | Tensor, num: int) -> Tensor:
        """Return whole numbers from 0 to limit - 1, shape (S, num); `limit` may be (S, 1)."""
        return _right(self.bits(num), 1) % limit

    def subset(self, limit: int, num: int) -> Tensor:
        """Return `num` different whole numbers below `limit`, shape (S, num), in any order."""
        return self.bits(limit).argsort(dim=-1)[:, :num]


def keys(seeds: Sequence[int], purpose: int) -> list[int]:
    """Return a key for each run; those of other purposes have nothing to do with them.

    The key is far away on SplitMix64's only cycle, so that runs of neighbouring seeds do not draw
    the same numbers a little later.
    """
    device = torch.device("cpu")
    mixed = Streams([seed & (2**64 - 1) for seed in seeds], device).bits(purpose + 1)
    return [int(key) & (2**64 - 1) for key in mixed[:, purpose]]


def _right(bits: Tensor, places: int) -> Tensor:
    """Shift unsigned numbers to the right; PyTorch's shift repeats the sign."""
    return (bits >> places) & ((1 << (64 - places)) - 1)
