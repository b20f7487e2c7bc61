"""Matrix products with factors in bfloat16 and sums in float32, as processors with AMX multiply fastest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import torch


@contextmanager
def products(*, bfloat16: bool) -> Iterator[None]:
    """Multiply float32 matrices in bfloat16, or as ever; all else is in float32 as ever.

    bfloat16 has float32's range and 8 bits of its 24-bit fraction, so what is rounded is each factor, once, by up to a
    256th of itself.
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
def bfloat16_products() -> bool:
    """Whether this processor multiplies faster in bfloat16: torch then does, by what a product comes to."""
    fine = torch.full((256, 256), 1 + 2**-10)
    with products(bfloat16=True):
        return not torch.equal(torch.mm(fine, torch.eye(256)), fine)
