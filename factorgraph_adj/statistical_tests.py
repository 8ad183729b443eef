"""Quantiles, probabilities and default levels of tests; global test of σ0, χ² test of an item.

The functions call `scipy.special`, as `scipy.stats` does, and give the same figures to the last
bit. The import of `scipy.stats` takes longer than the import of the rest of the package.

Every level has one meaning and one default in the whole package. A test, also a significance test,
takes ``alpha``, the probability that it rejects a true null hypothesis. A region or an interval
takes ``confidence``, the probability that it covers the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np
from scipy import special

from .errors import InputError
from .types import Array, Index

ALPHA_OF_OBSERVATION = 0.001
"""Probability α0 of a false alarm of the test of one observation, as in Baarda's data snooping."""
ALPHA_OF_MODEL = 0.05
"""Probability of a false alarm of one test of the model: the global test, a test of a parameter."""
POWER_OF_TEST = 0.80
"""Probability 1 − β0 with which a gross error of the smallest detectable size is found."""
CONFIDENCE_OF_REGION = 0.95
"""Probability with which an error ellipse or an interval covers the truth."""
SIGMA_PER_MEDIAN_DEVIATION = 1.4826
"""Ratio of σ to the median absolute deviation of a normal distribution."""
TOLERANCE_IN_SIGMAS = 3.29
"""Tolerance of a difference, in its standard deviations: exceeded by chance once in 1000."""
EQUAL_TEST_VALUES = 1e-6
"""Relative difference up to which two test values count as equal. They differ by rounding and by
what an iteration leaves to the minimum; up to 5e-8 was found."""


def descending(size: Array) -> Index:
    """Return the places of test values (n,), the largest first.

    Equal ones keep their order. The readings of a loop with one misclosure have the same test
    value, and rounding shall not decide which of them comes first.
    """
    order = np.argsort(-size, kind="stable")
    ranked = size[order]
    lower = ranked[1:] < (1.0 - EQUAL_TEST_VALUES) * ranked[:-1]
    rank = np.cumsum(np.append(False, lower))[: len(order)]
    return np.asarray(order[np.lexsort((order, rank))], dtype=np.intp)


def normal_quantile(p: float) -> float:
    """Return Φ⁻¹(p) of the standard normal distribution."""
    return float(special.ndtri(p))


def student_quantile(p: float, freedom: float) -> float:
    """Return the quantile p of Student's t with ``freedom`` > 0 degrees of freedom."""
    return float(special.stdtrit(freedom, p))


def normal_upper_probability(x: float) -> float:
    """Return the probability that a standard normal variable exceeds x."""
    return float(special.ndtr(-x))


def student_upper_probability(x: float, freedom: float) -> float:
    """Return the probability that a variable with Student's t distribution exceeds x."""
    return float(special.stdtr(freedom, -x))


def noncentrality_of_power(power_at: Callable[[float], float], power: float) -> float:
    """Return the noncentrality λ > 0 for which a test rejects with a probability.

    Args:
        power_at: λ → probability with which the test rejects; it grows with λ.
        power: the probability.
    """
    top = 10.0
    while power_at(top) < power:
        top *= 2.0
    return root(lambda x: power_at(x) - power, 1e-9, top, tolerance=1e-12)


def root(function: Callable[[float], float], low: float, high: float, *, tolerance: float) -> float:
    """Return where a function that changes its sign between two places is 0.

    Args:
        function: the function.
        low: a place.
        high: another one.
        tolerance: largest error of the result.
    """
    from scipy.optimize import brentq  # imported here, because few need it and it is slow

    return float(brentq(function, low, high, xtol=tolerance))


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


def chi2_lower_probability(x: float, freedom: float) -> float:
    """Return the probability that χ² with ``freedom`` > 0 degrees of freedom is at most x."""
    return float(special.chdtr(freedom, x))


def chi2_upper_probability(x: float, freedom: float) -> float:
    """Return the probability that χ² with ``freedom`` > 0 degrees of freedom exceeds x."""
    return float(special.chdtrc(freedom, x))


def fisher_quantile(p: float, numerator: float, denominator: float) -> float:
    """Return the quantile p of Fisher's F with these degrees of freedom, both > 0."""
    return float(special.fdtri(numerator, denominator, p))


def fisher_upper_probability(x: float, numerator: float, denominator: float) -> float:
    """Return the probability that Fisher's F with these degrees of freedom > 0 exceeds x."""
    return float(special.fdtrc(numerator, denominator, x))


def poisson_upper_probability(n: int, mean: float) -> float:
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


class AdjustmentFigures(Protocol):
    """An adjustment, of a whole network or in parts."""

    @property
    def vtpv(self) -> float:
        """Weighted sum vᵀPv."""
        ...

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        ...


GlobalOutcome: TypeAlias = Literal["untested", "accepted", "too_small", "too_large"]
"""What a global test finds: σ̂0 lies between its bounds, below or above them; ``untested``: nothing
is redundant. Above them there are errors, or σ that are stated too small; below them there is no
error: the readings are better than their σ say, or not independent."""


@dataclass(frozen=True)
class GlobalTest:
    """Two-sided test of σ̂0² = vᵀPv/r against σ0² = 1."""

    vtpv: float
    """vᵀPv, distributed as χ² with r degrees of freedom for the right model and weights."""
    redundancy: int
    """Redundancy r."""
    alpha: float
    """Probability α with which the right model and weights are rejected, such as 0.05."""
    lower: float
    """Smallest accepted σ̂0; 0 without redundancy."""
    upper: float
    """Largest accepted σ̂0; infinite without redundancy."""

    @property
    def sigma0(self) -> float:
        """σ̂0; NaN without redundancy."""
        return float((self.vtpv / self.redundancy) ** 0.5) if self.redundancy > 0 else float("nan")

    @property
    def accepted(self) -> bool:
        """Whether σ̂0 lies between the bounds; always true without redundancy."""
        return self.redundancy <= 0 or self.lower <= self.sigma0 <= self.upper

    @property
    def too_good(self) -> bool:
        """Whether σ̂0 lies below the bounds: the readings fit better than their σ say."""
        return self.redundancy > 0 and self.sigma0 < self.lower

    @property
    def outcome(self) -> GlobalOutcome:
        """What the test found."""
        if self.redundancy <= 0:
            return "untested"
        if self.accepted:
            return "accepted"
        return "too_small" if self.too_good else "too_large"


def global_test(solution: AdjustmentFigures, *, alpha: float = ALPHA_OF_MODEL) -> GlobalTest:
    """Test the standard deviation of unit weight of a solution.

    The test accepts if χ²_{α/2, r} ≤ vᵀPv ≤ χ²_{1 − α/2, r}. The bounds are given for
    σ̂0 = √(vᵀPv/r).

    Raises:
        InputError: alpha is not between 0 and 1.
    """
    if not 0 < alpha < 1:
        raise InputError(f"alpha must lie between 0 and 1, not {alpha}")
    r = solution.redundancy
    if r <= 0:
        return GlobalTest(solution.vtpv, r, alpha, 0.0, float("inf"))
    tail = alpha / 2.0
    low, high = (chi2_quantile(p, r) for p in (tail, 1.0 - tail))
    return GlobalTest(solution.vtpv, r, alpha, (low / r) ** 0.5, (high / r) ** 0.5)
