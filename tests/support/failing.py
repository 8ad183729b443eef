"""Calls of the system that fail when their number is reached."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

CALLS = (
    *((os, name) for name in ("fsync", "link", "replace", "unlink", "mkdir", "rmdir", "open")),
    (io, "open"),
)
"""Functions that change files or open them."""


class Calls:
    """How many calls there were."""

    def __init__(self) -> None:
        """Start at none."""
        self.number = 0
        self.failed = 0


@contextmanager
def failing(error: Callable[[], BaseException], fails: Callable[[int], bool]) -> Iterator[Calls]:
    """Let calls of the system fail before they have any effect.

    Args:
        error: makes the error.
        fails: whether the call with this number, from 1, fails.
    """
    calls = Calls()

    def counted(call):
        def counting(*given, **options):
            calls.number += 1
            if fails(calls.number):
                calls.failed += 1
                raise error()
            return call(*given, **options)

        return counting

    # Waiting for the disk is slow, and no matter of these tests.
    own = {"fsync": lambda descriptor: None}
    patches = [
        patch.object(where, name, counted(own.get(name, getattr(where, name))))
        for where, name in CALLS
    ]
    for each in patches:
        each.start()
    try:
        yield calls
    finally:
        for each in patches:
            each.stop()
