"""Matrix products with bfloat16 factors and float32 sums, the fastest on processors with AMX."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import torch


@contextmanager
def matrix_products(*, bfloat16: bool) -> Iterator[None]:
    """Let float32 matrix products round their factors to bfloat16, if `bfloat16` is set.

    Everything but matrix products stays in float32. bfloat16 has the range of float32 and 8 of
    its 24 significant bits, so each factor is rounded once, by at most 1/256 of itself.
    """
    if not bfloat16:
        yield
        return
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@cache
def has_fast_bfloat16() -> bool:
    """Return whether this processor multiplies faster in bfloat16.

    Torch uses bfloat16 only where it is faster; the rounding of a product shows whether it did.
    """
    fine = torch.full((256, 256), 1 + 2**-10)
    with matrix_products(bfloat16=True):
        return not torch.equal(torch.mm(fine, torch.eye(256)), fine)
