"""Whether the residuals of an adjustment are larger than chance explains."""

from __future__ import annotations

import numpy as np

from ..types import Array

MAX_BY_CHANCE = 4.0
"""Largest excess of vᵀPv over its expectation, in its standard deviations, that is chance."""
MIN_WEIGHT_FACTOR = 0.5
"""Smallest factor on the weight of an observation that takes part in the judgement."""
MEDIAN_OF_CHI2 = 0.4549364
"""Median of the χ² distribution with one degree of freedom."""


def fits_badly(v: Array, factors: Array | None, n_determined: int, *, relative: bool) -> bool:
    """Return whether vᵀPv is larger than chance explains.

    For normal errors E(vᵀPv) = s² r with the standard deviation s² √(2 r), r = n − u. Observations
    that an estimator has given next to no weight say nothing, and count neither in vᵀPv nor in n.
    Where standard deviations are known but for a factor, s² comes from the median of v², whose
    relative variance is 2.72 times that of vᵀPv/r; a few gross errors change vᵀPv and not s².

    Args:
        v: residuals in units of their standard deviations with these factors, (n,).
        factors: factors on the weights of the first observations, at most n; none: 1.
        n_determined: number of unknowns that the observations determine, u.
        relative: whether s² is unknown; otherwise it is 1.
    """
    used = np.ones(len(v), dtype=bool)
    if factors is not None:
        used[: len(factors)] = factors >= MIN_WEIGHT_FACTOR
    squares = np.square(v[used])
    r = len(squares) - n_determined
    if r <= 0:
        return False
    variance, spread = 1.0, np.sqrt(2.0 / r)
    if relative:
        variance = float(np.median(squares)) / MEDIAN_OF_CHI2 * len(squares) / r
        spread = np.sqrt((1.0 + 2.72) * 2.0 / r)
    return bool(squares.sum() > variance * r * (1.0 + MAX_BY_CHANCE * spread))
