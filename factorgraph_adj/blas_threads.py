"""Decorators for one BLAS thread during computations, and for one method at a time of an object.

The BLAS libraries of numpy and scipy start as many threads as there are processors. The matrices
here are small: with two threads an adjustment takes twice the CPU time that it takes with one, and
more wall time. Every public computation therefore runs with one thread, by threadpoolctl, and
leaves the process as it was. The number of threads also changes the last digits of sums, which then
are the same on every machine.

Objects that several threads may use have methods of which one runs at a time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock, RLock, local
from typing import TYPE_CHECKING, Concatenate, ParamSpec, Protocol, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController, threadpool_limits

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment variables that set the number of threads of libraries loaded later."""

Given = ParamSpec("Given")
Found = TypeVar("Found")


class _OneThread:
    """One thread while a computation runs; each thread of Python gives the others back itself.

    OpenBLAS takes a number of threads from the main thread alone, or from each for itself, or for
    all, as it was built. What all give back is what there was before the first one began.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._running = 0
        self._limits: threadpool_limits | None = None
        self._own = local()

    def __enter__(self) -> None:
        self._own.depth = getattr(self._own, "depth", 0) + 1
        if self._own.depth == 1:
            with self._lock:
                limits = _libraries().limit(limits=1)
                if not self._running:
                    self._limits = limits
                self._running += 1

    def __exit__(self, *error: object) -> None:
        self._own.depth -= 1
        if not self._own.depth:
            with self._lock:
                self._running -= 1
                if self._limits is not None:
                    self._limits.restore_original_limits()


one_thread = _OneThread()
"""Context in which BLAS has one thread; 9 µs, and less inside another."""


def with_one_thread(function: Callable[Given, Found]) -> Callable[Given, Found]:
    """Return a function during which BLAS has one thread."""

    @wraps(function)
    def bounded(*args: Given.args, **kwargs: Given.kwargs) -> Found:
        with one_thread:
            return function(*args, **kwargs)

    return bounded


def use_one_thread() -> None:
    """Set one thread permanently, in a process that only runs repetitions."""
    _libraries().limit(limits=1)


def numbers_of_threads() -> tuple[int, ...]:
    """Return the number of threads of each library."""
    return tuple(int(library["num_threads"]) for library in _libraries().info())


@contextmanager
def one_thread_for_children() -> Iterator[None]:
    """Let processes that start inside this context use one thread."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@cache
def _libraries() -> ThreadpoolController:
    """Return the BLAS libraries, once those of numpy and scipy are loaded."""
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


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
