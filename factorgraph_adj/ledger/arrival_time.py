"""Times of arrivals: in seconds from any moment, and in ticks of the clock of a ledger."""

from __future__ import annotations

from math import isfinite
from numbers import Real

from ..errors import InputError

TICKS_PER_SECOND = 1_000_000
"""Resolution of the times of arrivals."""
MIN_SECONDS = 1e-3
"""Shortest time for which arrivals can be kept, seconds."""
MAX_SECONDS = 1e11
"""Latest time of an arrival, seconds: more than three thousand years."""


def is_seconds(value: object, *, least: float = 0.0) -> bool:
    """Return whether a value is a number of seconds, from ``least`` to `MAX_SECONDS`."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    return isfinite(value) and least <= float(value) <= MAX_SECONDS


def checked(time: object, latest: float | None) -> float:
    """Return the time of an arrival, in seconds.

    Args:
        time: the time.
        latest: that of the latest arrival; none: no other stated one.

    Raises:
        InputError: it is no time, or before the latest arrival.
    """
    if not isinstance(time, Real) or not is_seconds(time):
        what = f"the time of an arrival must be from 0 to {MAX_SECONDS:g} seconds"
        raise InputError(f"{what}; not {time!r}")
    if latest is not None and time < latest:
        what = f"the time of an arrival, {time!r} s, must not be before that of an earlier one"
        raise InputError(f"{what}, {latest!r} s")
    return float(time)


def ticks(seconds: float) -> int:
    """Return a time as a number of ticks."""
    return round(TICKS_PER_SECOND * seconds)
