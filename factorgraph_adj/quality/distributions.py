"""Quantiles and probabilities of the distributions that tests and intervals use.

They call `scipy.special`, as `scipy.stats` does, and give the same figures to the last bit. The
import of `scipy.stats` takes longer than the import of the rest of the package.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from ..types import Array


def normal_quantile(p: float) -> float:
    """Return Φ⁻¹(p) of the standard normal distribution."""
    return float(special.ndtri(p))


def student_quantile(p: float, freedom: float) -> float:
    """Return the quantile p of Student's t with ``freedom`` > 0 degrees of freedom."""
    return float(special.stdtrit(freedom, p))


def normal_above(x: float) -> float:
    """Return the probability that a standard normal variable exceeds x."""
    return float(special.ndtr(-x))


def student_above(x: float, freedom: float) -> float:
    """Return the probability that a variable with Student's t distribution exceeds x."""
    return float(special.stdtr(freedom, -x))


def chi2_quantile(p: float, freedom: float) -> float:
    """Return the quantile p of χ² with ``freedom`` > 0 degrees of freedom."""
    return float(2.0 * special.gammaincinv(freedom / 2.0, p))


def chi2_upper_quantile(q: float, freedom: float | Array) -> Array:
    """Return the values that χ² exceeds with probability q: its quantiles 1 − q.

    For small q the result has more correct digits than `chi2_quantile`, since 1 − q is rounded.

    Args:
        q: probability, between 0 and 1.
        freedom: degrees of freedom > 0, of any shape.

    Returns:
        The values, in the shape of ``freedom``.
    """
    return np.asarray(special.chdtri(freedom, q), dtype=float)


def chi2_below(x: float, freedom: float) -> float:
    """Return the probability that χ² with ``freedom`` > 0 degrees of freedom is at most x."""
    return float(special.chdtr(freedom, x))


def chi2_above(x: float, freedom: float) -> float:
    """Return the probability that χ² with ``freedom`` > 0 degrees of freedom exceeds x."""
    return float(special.chdtrc(freedom, x))


def fisher_quantile(p: float, numerator: float, denominator: float) -> float:
    """Return the quantile p of Fisher's F with these degrees of freedom, both > 0."""
    return float(special.fdtri(numerator, denominator, p))


def poisson_from(n: int, mean: float) -> float:
    """Return the probability that a Poisson variable of this mean > 0 is n or more, n ≥ 1."""
    return float(special.pdtrc(n - 1, mean))


class ChiSquareTest:
    """A test of an item with all its components, T² against χ²; its figures are those of a class.

    A plain base: a data class that derives from it states the three figures where it lists them.
    """

    t2: float
    """T²."""
    dof: int
    """Its degrees of freedom; 0: nothing else controls the item."""
    critical: float
    """Its critical value."""

    @property
    def controlled(self) -> bool:
        """Whether anything else controls it."""
        return self.dof > 0

    @property
    def test(self) -> float:
        """√(T²/critical): beyond the critical value above 1; NaN where nothing controls it."""
        return float(np.sqrt(self.t2 / self.critical)) if self.dof else np.nan
