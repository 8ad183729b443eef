"""One BLAS thread in this process and in processes that it starts.

OpenBLAS divides sums among its threads, so that the last digits of a result depend on the number
of threads. An environment variable sets this number only before numpy is loaded; loaded libraries
are set by their own functions.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import scipy

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment variables that set the number of threads of libraries loaded later."""
_NAMES = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the libraries that come with numpy and scipy use one thread.

    Other libraries (MKL, the system's own) are not changed; set their variable, such as
    ``MKL_NUM_THREADS=1``, before Python starts.
    """
    before = [(setter, getter()) for getter, setter in _libraries()]
    try:
        use_one_blas_thread()
        yield
    finally:
        for setter, count in before:
            setter(count)


def use_one_blas_thread() -> None:
    """Set one thread permanently, in a process that only runs repetitions."""
    for _, setter in _libraries():
        setter(1)


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
def _libraries() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """Return the functions of each library that get and set its number of threads."""
    found = []
    for package in (np, scipy):
        folder = Path(str(package.__file__)).parent
        beside = folder.with_name(f"{folder.name}.libs")
        for path in sorted([*beside.glob("*openblas*"), *folder.glob(".dylibs/*openblas*")]):
            try:
                library = ctypes.CDLL(str(path))  # returns the library that is already loaded
            except OSError:
                continue
            for name in _NAMES:
                getter = getattr(library, name.format("get"), None)
                setter = getattr(library, name.format("set"), None)
                if getter is not None and setter is not None:
                    setter.argtypes, setter.restype = [ctypes.c_int], None
                    found.append((getter, setter))
                    break
    return tuple(found)
