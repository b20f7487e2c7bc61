"""Objects that several threads may call: each call waits until the one before has ended."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from threading import RLock
from typing import Any, TypeVar

T = TypeVar("T")


class Turn:
    """A lock of one object; a copy of the object gets a lock of its own."""

    def __init__(self) -> None:
        self._lock = RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Turn], tuple[()]]:
        return Turn, ()


def taking_turns(kind: type[T]) -> type[T]:
    """Let one thread at a time be inside the public methods that a class defines, on one object.

    Engines step outside Python's own lock, so that without this another thread could close what
    steps, or read a state that is half of one step and half of the next.
    """
    for name, method in list(vars(kind).items()):
        if isfunction(method) and (not name.startswith("_") or name == "__reduce__"):
            setattr(kind, name, _in_turn(method))
    return kind


# The signatures of the methods are kept, for which Python has no type.
def _in_turn(method: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(method)
    def waiting(self: object, /, *args: Any, **options: Any) -> Any:
        own = vars(self)
        turn = own.get("_turn") or own.setdefault("_turn", Turn())  # one, whoever comes first
        with turn:
            return method(self, *args, **options)

    return waiting
