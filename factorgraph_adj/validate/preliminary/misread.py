"""What a reading, or a given coordinate, may be instead of what it seems to be.

Readings: another unit, the other sign, exchanged components. Coordinates: the other sign, or two
neighbouring digits exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import numpy as np

from ...types import Array

DECIMALS = 4
"""Number of decimals of a coordinate, metres, that are looked at for exchanged digits."""


def exchanged_components(value: Array) -> Iterator[tuple[str, Array]]:
    """Iterate over vectors with two components exchanged, with a name for each, (3,).

    Vectors of other numbers of components have none.
    """
    for i, j in combinations(range(len(value)), 2) if len(value) == 3 else ():
        order = [0, 1, 2]
        order[i], order[j] = j, i
        yield f"with {'xyz'[i]} and {'xyz'[j]} exchanged", value[order]


def other_signs(value: Array) -> Iterator[tuple[str, Array]]:
    """Iterate over values with the other sign, and vectors with that of one component, (d,)."""
    yield "with the other sign", -value
    for i in range(len(value)) if len(value) == 3 else ():
        sign = np.ones(3)
        sign[i] = -1.0
        yield f"with the other sign of {'xyz'[i]}", sign * value


def mistyped(value: float) -> Iterator[tuple[str, float]]:
    """Iterate over what a coordinate may be: with the other sign, or with two digits exchanged.

    Args:
        value: the coordinate as given, metres.
    """
    yield "with the other sign", -value
    digits = f"{abs(value):.{DECIMALS}f}"
    sign = "-" if value < 0 else ""
    places = [i for i, c in enumerate(digits) if c != "."]
    for a, b in pairwise(places):
        if digits[a] != digits[b]:
            other = list(digits)
            other[a], other[b] = other[b], other[a]
            text = sign + "".join(other).rstrip("0").rstrip(".")
            yield f"as {text} m", float(text)
