"""Readings that both epochs have: a file that was compared with itself, or copied in part."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ..solve.solution import Solution

PART = 0.5
"""Smallest part of equal readings of an epoch that is told: some are equal by chance."""


def identical_readings(first: Solution, second: Solution) -> tuple[int, int]:
    """Return how many readings of two epochs are equal, and how many the larger epoch has.

    Readings are equal if they have the same kind and names, and the same numbers to the last digit;
    given values of weighted unknowns do not count.
    """
    a, b = (Counter(_readings(s)) for s in (first, second))
    return (a & b).total(), max(a.total(), b.total())


def _readings(s: Solution) -> Iterator[tuple[object, ...]]:
    for block in s.equations.blocks:
        if block.prior:
            continue
        named = [(kind, s.equations.unknowns[kind].names, index) for kind, index in block.variables]
        for i, values in enumerate(block.observed.tolist()):
            names = tuple((kind, every[index[i]]) for kind, every, index in named)
            yield (block.kind, names, tuple(values))


def told(first: Solution, second: Solution) -> str:
    """Return a sentence on equal readings; empty where few are equal."""
    n, every = identical_readings(first, second)
    if not n or n < PART * every:
        return ""
    if n == every:
        return (
            f"ATTENTION: both epochs have the same {n} readings, digit by digit: one epoch was "
            "compared with itself, and nothing can have moved. Give the other epoch."
        )
    return (
        f"ATTENTION: {n} of {every} readings are the same in both epochs, digit by digit: were "
        "they copied from one epoch to the other?"
    )
