"""Methods of an object that several threads may call: one at a time, the others wait."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import RLock
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from ..blas_threads import one_thread

Given = ParamSpec("Given")
Found = TypeVar("Found")


class HasLock(Protocol):
    """An object with a lock, which a thread that holds it may take again."""

    _lock: RLock


Own = TypeVar("Own", bound=HasLock)


def one_at_a_time(
    method: Callable[Concatenate[Own, Given], Found],
) -> Callable[Concatenate[Own, Given], Found]:
    """Return a method that holds the lock of its object while it runs."""

    @wraps(method)
    def alone(self: Own, /, *args: Given.args, **kwargs: Given.kwargs) -> Found:
        with self._lock, one_thread:
            return method(self, *args, **kwargs)

    return alone
