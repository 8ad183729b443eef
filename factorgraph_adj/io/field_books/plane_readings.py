"""Readings of a sight in a plane network: slope distances as horizontal ones, no zenith readings.

Readers with the option ``dimension`` pass the readings of a sight through `plane_readings`, and
leave out what gives heights alone with the reason `NOT_IN_PLAN`.
"""

from __future__ import annotations

import math

from ..source import LeftOutReason, Source

NOT_IN_PLAN = LeftOutReason(
    "readings and height differences", "a plane network (dimension = 2) has no heights"
)


def plane_readings(
    source: Source,
    line: int,
    target: str,
    *,
    zenith: float | None,
    distance: float | None,
    horizontal: float | None,
) -> float | None:
    """Return the horizontal distance of a sight; None where there is none.

    A slope distance s with a zenith reading z is the horizontal distance s·|sin z|. A slope
    distance alone, and a zenith reading that reduces none, are left out.

    Args:
        source: the file, which counts what is left out.
        line: line of the sight.
        target: its target.
        zenith: zenith reading of either face, radians.
        distance: slope distance, metres; it counts before a horizontal one.
        horizontal: horizontal distance, metres.
    """
    if distance is not None and zenith is not None:
        return distance * abs(math.sin(zenith))
    if distance is not None or zenith is not None:
        source.leave_out(line, NOT_IN_PLAN, target)
    return horizontal
