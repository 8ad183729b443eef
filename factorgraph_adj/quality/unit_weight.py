"""The global test of vᵀPv against the a-priori standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ..errors import InputError
from .distributions import chi2_quantile
from .levels import ALPHA_OF_MODEL


class Adjusted(Protocol):
    """An adjustment, of a whole network or in parts."""

    @property
    def vtpv(self) -> float:
        """Weighted sum vᵀPv."""
        ...

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        ...


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


def global_test(solution: Adjusted, *, alpha: float = ALPHA_OF_MODEL) -> GlobalTest:
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
