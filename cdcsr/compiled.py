"""Functions that Numba compiles, kept between processes where there is a place to keep them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from hashlib import sha256
from types import FunctionType
from typing import TypeVar, cast

import numba
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])


def compiled(fastmath: Collection[str] = ()) -> Callable[[F], F]:
    """Return a decorator that compiles a function when it is first called.

    Numba keeps the machine code beside the source, in the user's cache folder, or in the folder
    that the environment variable NUMBA_CACHE_DIR names. Where it may write to none of them, every
    process compiles anew. Code is kept for the function with all compiled functions that it calls.

    Args:
        fastmath: the liberties with floating-point numbers that the compiler may take.
    """

    def decorate(function: F) -> F:
        made = numba.njit(fastmath=set(fastmath))(function)
        with suppress(RuntimeError):  # no place for the machine code
            made._cache = _Cache(function)  # type: ignore[attr-defined]  # untyped
        return cast(F, made)  # it is called as the function is

    return decorate


class _Cache(FunctionCache):
    """Machine code that is compiled anew when a function that it calls has changed.

    Machine code holds that of the functions that it calls, and the constants that they name. Numba
    looks only at the file of the function itself, and would run the old code of the others.
    """

    def _index_key(self, sig: object, codegen: object) -> tuple[object, object, tuple[str, str]]:
        """Return by what the machine code for a signature is found."""
        signature, target, (code, cells) = super()._index_key(sig, codegen)
        parts = _parts(cast(FunctionType, self._py_func), set())
        return signature, target, (code, cells + sha256("\n".join(parts).encode()).hexdigest())


def _parts(function: FunctionType, seen: set[FunctionType]) -> Iterator[str]:
    """Yield as text what the machine code of a function depends on, but for those already seen."""
    seen.add(function)
    code = function.__code__
    yield f"{code.co_code.hex()} {code.co_consts} {code.co_names} {code.co_varnames}"
    for name in code.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, Dispatcher):
            yield f"{name} {sorted(value.targetoptions.items(), key=str)}"
            if value.py_func not in seen:
                yield from _parts(value.py_func, seen)
        elif isinstance(value, bool | int | float | str | tuple):
            yield f"{name} {value!r}"


def cache_folder() -> str | None:
    """Return a folder in which machine code is kept, or None if there is no place for it."""
    found: str | None = cast(Dispatcher, compiled()(_nothing)).stats.cache_path
    return found


def _nothing() -> None: ...
