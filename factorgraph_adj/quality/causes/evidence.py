"""How much an error explains, where σ0 is known, and where it is estimated.

An error with q components makes vᵀPv smaller by T². Without an error

    T² / σ0² ~ χ²_q,                                      σ0 known,
    F = (T² / q) / ((vᵀPv − T²) / (r − q)) ~ F(q, r−q),   σ0 estimated, with the redundancy r.

vᵀPv − T² is what is left with the error as an unknown. It does not contain the error, where
T² r / vᵀPv does and cannot exceed r: a gross error hides itself there. The evidence of an error is
minus the logarithm of the probability that good readings make as much or more,

    −ln P(χ²_q > T² / σ0²)   or   −ln P(F(q, r−q) > F) = −ln I_x((r−q)/2, q/2),  x = 1 − T² / vᵀPv,

with the incomplete beta function I. Of two errors with as many components the difference of
evidence is nearly the logarithm of the ratio of their likelihoods, ½ ΔT² / σ0² or
(r − q)/2 · Δ ln(vᵀPv − T²). With r = q nothing is left that tells of σ0, and there is no evidence.
With r = q + 1 one residual does: of two errors whose tests have a correlation of 0.9 or 0.99, the
wrong one is ahead by `SAME` in 27 to 31 % of the cases in which one is shown: there is none either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betainc, betaln, gammaincc, gammaln, hyp2f1

from ...solve.solution import Solution
from ..distributions import chi2_quantile, fisher_quantile

LEAST_FREEDOM = 2
"""Smallest number of degrees of freedom that an estimate of σ0 has if it is to tell of an error."""
ROUNDING = 1e-10
"""Share of vᵀPv below which what is left of it is rounding."""


@dataclass(frozen=True)
class VarianceFactor:
    """The variance σ0² of unit weight by which T² is judged."""

    variance: float = 1.0
    """σ0², or its estimate."""
    freedom: float = np.inf
    """Degrees of freedom of the estimate; infinite where σ0 is known, 0 where there are fewer than
    `LEAST_FREEDOM`: nothing tells."""

    @classmethod
    def left_by(
        cls, solution: Solution, *, estimated: bool, t2: float = 0.0, dof: int = 0
    ) -> VarianceFactor:
        """Return the variance with an error as an unknown.

        Args:
            solution: the adjustment without the error as an unknown.
            estimated: whether σ0 is estimated; otherwise it is 1.
            t2: T² of the error, σ0 = 1.
            dof: number of its components q.
        """
        if not estimated:
            return cls()
        freedom = solution.redundancy - dof
        if freedom < LEAST_FREEDOM or not solution.vtpv > 0.0:
            return cls(np.inf, 0.0)
        return cls(max(solution.vtpv - t2, ROUNDING * solution.vtpv) / freedom, freedom)

    def limit(self, dof: int, alpha: float) -> float:
        """Return T², σ0 = 1, that good readings exceed with probability alpha; 0: nothing tells."""
        return self.variance * self.critical(dof, alpha) if self.freedom > 0 else 0.0

    def critical(self, dof: int, alpha: float) -> float:
        """Return T² / σ0² that good readings exceed with probability alpha; infinite: no test."""
        if self.freedom <= 0:
            return np.inf
        if np.isinf(self.freedom):
            return chi2_quantile(1.0 - alpha, dof)
        return dof * fisher_quantile(1.0 - alpha, dof, self.freedom)


def evidence(t2: float, dof: int, freedom: float = np.inf) -> float:
    """Return −ln P(χ² > T²), or −ln P(F > T² / q), without an error.

    Where the probability underflows, its expansion takes its place.

    Args:
        t2: T² / σ0², of an estimated σ0 the estimate without the error.
        dof: degrees of freedom q of T².
        freedom: degrees of freedom of the estimate of σ0.
    """
    if freedom <= 0:
        return 0.0
    half = 0.5 * dof
    if np.isinf(freedom):
        found = float(gammaincc(half, 0.5 * t2))
        first = gammaln(half) + 0.5 * t2 - (half - 1.0) * np.log(max(0.5 * t2, 1.0))
    else:
        a, x = 0.5 * freedom, freedom / (freedom + t2)
        found = float(betainc(a, half, x))
        first = np.log(a) + betaln(a, half) - a * np.log(x)
        first -= np.log(hyp2f1(a, 1.0 - half, a + 1.0, x)) if x < 1.0 else 0.0
    return -float(np.log(found)) if found > 0.0 else float(first)
