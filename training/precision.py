"""Matrix products with factors in bfloat16 and sums in float32, as processors with AMX multiply fastest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from training.config import Learner


@contextmanager
def products(learner: Learner) -> Iterator[None]:
    """Multiply float32 matrices as the learner says; everything before and after is in float32 as ever.

    bfloat16 has float32's range and 8 bits of its 24-bit fraction, so what is rounded is each factor, once, by up to a
    256th of itself. It is a permission: where it is not faster, the products stay what they are.
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if learner.bfloat16 else before)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def bfloat16_products() -> bool:
    """Whether this processor makes use of that permission, by what a product comes to."""
    before, fine = torch.get_float32_matmul_precision(), torch.full((256, 256), 1 + 2**-10)
    torch.set_float32_matmul_precision("medium")
    try:
        rounded = torch.mm(fine, torch.eye(256))
    finally:
        torch.set_float32_matmul_precision(before)
    return not torch.equal(rounded, fine)
