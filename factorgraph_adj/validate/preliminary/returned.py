"""Returns that were not measured: back readings that are the forth ones with the sign turned."""

from __future__ import annotations

from collections import defaultdict
from math import isfinite, pi, sqrt

import numpy as np

from ...network.network import Network
from ...observations import HeightDifference
from ...quality.distributions import poisson_from
from .closures import of_line
from .repeated import CHANCE, reading, resolution

LEAST_EQUAL = 3
"""Smallest number of lines that are noted: of one or two nobody knows."""


def copied_returns(network: Network) -> list[str]:
    """Return a note on back readings that equal the forth ones in all digits; none: they do not.

    Forth and back of a line with resolution u and standard deviation s cancel with the probability
    p = u / (2 √π s). More lines than chance makes were computed, or copied, and count twice.
    """
    lines: dict[tuple[str, str], list[HeightDifference]] = defaultdict(list)
    for o in network.observations.values():
        if isinstance(o, HeightDifference) and o.instrument_height == o.target_height == 0.0:
            lines[o.station, o.target].append(o)
    pairs = [
        (forth, back)
        for (a, b), some in lines.items()
        if a < b and len(some) == 1 and len(lines.get((b, a), ())) == 1
        for forth, back in zip(some, lines[b, a], strict=True)
    ]
    equal = [(forth, back) for forth, back in pairs if forth.value == -back.value]
    if len(equal) < LEAST_EQUAL:
        return []
    step = resolution(np.concatenate([reading(o) for pair in pairs for o in pair]))
    expected = 0.0
    for forth, _ in pairs:
        ends = (np.array(network.points[n].coordinates) for n in (forth.station, forth.target))
        s = of_line(forth, *ends)
        expected += min(1.0, step / (2.0 * sqrt(pi) * s)) if isfinite(s) and s > 0 else 1.0
    if poisson_from(len(equal), expected) > CHANCE:
        return []
    first, second = equal[0]
    return [
        f"{len(equal)} of {len(pairs)} lines that were levelled forth and back have the same value "
        f"with the other sign in all digits, the first {first.label()} and {second.label()}: if "
        "the back readings were copied, leave them out, as they make the result look more precise "
        "than it is"
    ]
