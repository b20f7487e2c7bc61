"""Functions that Numba compiles, kept between processes where there is a place to keep them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TypeVar, cast

import numba
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])


def compiled(fastmath: Collection[str] = ()) -> Callable[[F], F]:
    """Return a decorator that compiles a function when it is first called.

    Numba keeps the machine code beside the source, in the user's cache folder, or in the folder
    that the environment variable NUMBA_CACHE_DIR names. Where it may write to none of them, every
    process compiles anew.

    Args:
        fastmath: the liberties with floating-point numbers that the compiler may take.
    """

    def decorate(function: F) -> F:
        try:
            made = numba.njit(cache=True, fastmath=set(fastmath))(function)
        except RuntimeError:  # no place for the machine code
            made = numba.njit(fastmath=set(fastmath))(function)
        return cast(F, made)  # it is called as the function is

    return decorate


def cache_folder() -> str | None:
    """Return a folder in which machine code is kept, or None if there is no place for it."""
    found: str | None = cast(Dispatcher, compiled()(_nothing)).stats.cache_path
    return found


def _nothing() -> None: ...
