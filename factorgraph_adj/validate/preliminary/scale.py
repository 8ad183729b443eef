"""The scale of what was measured against given coordinates, where readings alone do not tell it.

Where new points have no coordinates, distances cannot be compared one by one. Traverses between
held points can: from end to end they are as long as their ends are apart. So can places in a frame
whose scale is held. Where one factor explains them all, it is that of a unit, or of a scale.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...frames import LocalFrame
from ...network.network import Network
from ...units import significant
from .finding import Finding
from .given_rows import BETTER
from .given_units import length_factors
from .legs import Survey
from .traverses import between_held

LEAST_TRAVERSES = 2
"""Smallest number of traverses that tell a factor."""
NEAR = 0.01
"""Largest relative difference of a factor from that of a unit."""
LARGE = 0.1
"""Smallest difference of a factor from 1 that is told: smaller ones are scales that an adjustment
tests as causes."""


def meaning(factor: float, length: str) -> str:
    """Return what a factor between lengths and coordinates may mean; empty: no unit has it.

    Args:
        factor: factor by which lengths fit the coordinates.
        length: unit of lengths in the files.
    """
    factors = length_factors(length)
    unit = min(factors, key=lambda n: abs(np.log(factors[n] / factor)))
    if abs(factors[unit] / factor - 1.0) > NEAR:
        return ""
    return f", as {unit}"


def traverse_scale(network: Network, length: str) -> Iterator[Finding]:
    """Tell the factor by which traverses are as long as the held points at their ends are apart.

    Args:
        network: the network.
        length: unit of lengths in its files.
    """
    if not isinstance(network.frame, LocalFrame):
        return
    survey = Survey.of(network)
    factors = []
    for t in between_held(survey):
        x = t.computed()[0]
        reached = float(np.hypot(*(x[-1] - x[0])))
        apart = float(np.hypot(*(survey.held[t.points[-1]] - survey.held[t.points[0]])))
        if reached > 0.0 and apart > 0.0:
            factors.append(apart / reached)
    if len(factors) < LEAST_TRAVERSES:
        return
    ln = np.log(factors)
    middle = float(np.median(ln))
    spread = float(np.max(np.abs(ln - middle)))
    if abs(np.expm1(middle)) < LARGE or spread * BETTER > abs(middle):
        return
    factor = float(np.exp(middle))
    yield Finding(
        f"{len(factors)} traverses between held points are as long as these are apart with the "
        f"factor {significant(factor, 4)}{meaning(factor, length)}",
        f"state the unit of the distances, or that of the coordinates ({length} is stated)",
    )
