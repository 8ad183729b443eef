"""One BLAS thread, in this process too.

OpenBLAS divides sums among its threads: with another number of them the last digits of a result
are others. An environment variable sets the number before numpy is loaded only, so the loaded
libraries are told.
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
"""What tells libraries that are yet to be loaded."""
_NAMES = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the libraries that come with numpy and scipy use one thread.

    Others (MKL, the system's own) are left as they are; for them set their variable, such as
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
    """Do the same in a process that repetitions have for themselves, for good."""
    for _, setter in _libraries():
        setter(1)


@contextmanager
def one_thread_for_children() -> Iterator[None]:
    """Let processes that are started meanwhile use one thread."""
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
    """Return how the number of threads of each library is asked for and set."""
    found = []
    for package in (np, scipy):
        folder = Path(str(package.__file__)).parent
        beside = folder.with_name(f"{folder.name}.libs")
        for path in sorted([*beside.glob("*openblas*"), *folder.glob(".dylibs/*openblas*")]):
            try:
                library = ctypes.CDLL(str(path))  # it is loaded already: this is that one
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
