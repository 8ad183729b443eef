"""Factors that a user added, in the search of data snooping: each is set aside as a whole.

A factor is beyond the critical value where T² of its rows is. For Pope's test T²/vᵀPv has the
distribution Beta(d/2, (f − d)/2) with d degrees of freedom of the factor and the redundancy f, so
that one row is tested as an observation is.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from ..solve.extra import Extra
from ..solve.solution import Solution
from .distributions import chi2_quantile, fisher_quantile
from .factor_tests import FactorReliability
from .rejections import FactorSetAside, Test, Unresolved
from .reliability import Reliability


@dataclass
class FactorSearch:
    """The factors of a search."""

    given: Extra
    """All factors, with the unknowns that their keys belong to."""
    test: Test
    """The test that decides."""
    alpha: float
    """Probability α0 of a false alarm of one test."""
    aside: dict[str, FactorSetAside] = field(default_factory=dict)
    """Those that are set aside."""
    stuck: dict[str, str] = field(default_factory=dict)
    """Why others cannot be set aside."""
    readmitted: list[str] = field(default_factory=list)
    """Those that were put back, each once."""

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.given.factors)

    def without(self, names: Collection[str]) -> Extra:
        """Return the factors without some of them."""
        return self.given.without(names) if self else self.given

    def ratio(self, tested: FactorReliability, solution: Solution) -> float:
        """Return √(T²/critical) of a factor in a solution with it; 0 where nothing controls it."""
        d, f = tested.dof, solution.redundancy
        if not d:
            return 0.0
        if self.test == "baarda":
            return float(np.sqrt(tested.t2 / chi2_quantile(1.0 - self.alpha, d)))
        if f <= d or not solution.vtpv > 0.0:
            return 0.0
        quantile = fisher_quantile(1.0 - self.alpha, d, f - d)
        critical = solution.vtpv * d * quantile / (d * quantile + f - d)
        return float(np.sqrt(tested.t2 / critical))

    def ratios(self, rel: Reliability) -> dict[str, float]:
        """Return √(T²/critical) of all factors that are in a solution."""
        return {f.name: self.ratio(f, rel.solution) for f in rel.factors} if self else {}

    def worst(self, rel: Reliability) -> tuple[str, float]:
        """Return the factor that is furthest beyond its critical value; no name: none is."""
        beyond = {
            name: ratio
            for name, ratio in self.ratios(rel).items()
            if ratio > 1.0 and name not in self.stuck
        }
        return max(beyond.items(), key=lambda item: item[1], default=("", 0.0))

    def suspects(self, rel: Reliability) -> int:
        """Return the number of factors beyond their critical values."""
        return sum(ratio > 1.0 for ratio in self.ratios(rel).values())

    def unresolved(self, rel: Reliability) -> list[Unresolved]:
        """Return the factors that stay beyond their critical values, the largest first."""
        found = sorted(self.ratios(rel).items(), key=lambda item: -item[1])
        left = "the search stopped before it was its turn"
        return [
            Unresolved(name, "factor", name, "", ratio, np.nan, self.stuck.get(name, left))
            for name, ratio in found
            if ratio > 1.0
        ]
