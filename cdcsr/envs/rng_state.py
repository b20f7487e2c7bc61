"""The state of a random generator as an array, so that it can be saved beside other arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LIMB = 2**32
"""PCG64 holds two numbers of 128 bits; each is saved as four numbers below this."""


def pack_generator(rng: np.random.Generator) -> NDArray[np.int64]:
    """Return all that determines what a PCG64 generator, NumPy's default, draws next; shape
    (10,)."""
    state = rng.bit_generator.state
    inner = state["state"]
    limbs = [inner[name] // _LIMB**i % _LIMB for name in ("state", "inc") for i in range(4)]
    return np.array([*limbs, state["has_uint32"], state["uinteger"]], dtype=np.int64)


def unpack_generator(rng: np.random.Generator, packed: NDArray[np.int64]) -> None:
    """Set a PCG64 generator to a state made by :func:`pack_generator`."""
    numbers = [int(number) for number in packed]
    state, inc = (
        sum(limb * _LIMB**i for i, limb in enumerate(numbers[at : at + 4])) for at in (0, 4)
    )
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": numbers[8],
        "uinteger": numbers[9],
    }
