"""Results of data snooping: observations and points set aside, and unresolved observations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from ..network.network import Network
from ..shown import Rows, Shown
from ..solve.solution import Solution
from .causes.search import Causes
from .reliability import Reliability

Test = Literal["baarda", "pope"]
"""Baarda's w with σ0 = 1, or Pope's τ with the estimated σ̂0."""


@dataclass(frozen=True)
class Rejected:
    """An observation that was set aside."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    label: str
    """Readable name with the component of the largest test value, and the source."""
    component: str
    """Component with the largest test value, empty for scalar kinds."""
    test: float
    """Test value of the component, w or τ, in the adjustment with the observation."""
    estimated_error: float
    """Estimated gross error of the component, observed − true, in the same adjustment."""
    round: int
    """Round in which the observation was set aside; 0: before the first, by the start."""
    final_error: float
    """Observed − computed from the clean solution; NaN if that solution does not determine it."""
    final_sigma: float
    """Standard deviation of ``final_error`` without a gross error, a-priori σ0 = 1."""
    final_test: float
    """Test value of the observation put back into the clean solution: w or τ."""
    inseparable: tuple[tuple[str, float], ...]
    """Labels of inseparable observations at that round, with the correlations."""


@dataclass(frozen=True)
class FactorSetAside:
    """A factor of the user that was set aside, with all its rows."""

    name: str
    """Name of the factor."""
    test: float
    """√(T²/critical) in the adjustment with it; above 1. For Pope's test T² is relative to σ̂0²."""
    round: int
    """Round in which it was set aside."""
    final_test: float
    """√(T²/critical) of the factor put back into the clean solution."""


@dataclass(frozen=True)
class Unresolved:
    """An observation above the critical value that stays in the adjustment."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    label: str
    """Readable name with the component of the largest test value, and the source."""
    component: str
    """Component with the largest test value, empty for scalar kinds."""
    test: float
    """Test value, w or τ."""
    estimated_error: float
    """Estimated gross error, observed − true."""
    reason: str
    """Reason why the observation stays."""


@dataclass(frozen=True)
class PointSetAside:
    """A point that was removed with all its rays."""

    name: str
    """Name of the point."""
    rays: tuple[str, ...]
    """Ids of the rays removed with the point; its other rays were rejected before."""
    label: str
    """Label of the ray with the largest test value."""
    test: float
    """Largest test value, w or τ."""
    round: int
    """Round in which the point was removed; 0: before the first, by the start."""
    reason: str
    """Reason why the whole point was removed."""


@dataclass(frozen=True)
class Round:
    """One round of the search."""

    number: int
    """Number of the round."""
    sigma0: float
    """σ̂0 before the round sets anything aside."""
    largest: float
    """Largest |test value|."""
    suspects: int
    """Number of observations above the critical value."""
    set_aside: int
    """Number of observations set aside in the round, including the rays of removed points."""
    readmitted: int
    """Number of observations put back in the round."""


@dataclass(frozen=True, eq=False, repr=False)
class Snooping(Shown):
    """Result of data snooping."""

    solution: Solution
    """The adjustment without the observations that were set aside (the clean solution)."""
    reliability: Reliability
    """Reliability of ``solution``, with α0 and power of the tests."""
    rejected: tuple[Rejected, ...]
    """Observations set aside, in that order, without the rays of removed points."""
    readmitted: tuple[str, ...]
    """Ids of observations that fitted and were put back, including those rejected again later."""
    points_set_aside: tuple[PointSetAside, ...]
    """Points removed with all their rays, since the remaining rays did not determine them."""
    unresolved: tuple[Unresolved, ...]
    """Observations above the critical value that cannot be set aside."""
    rounds: tuple[Round, ...]
    """The rounds of the search."""
    critical: float
    """Critical value of the last round."""
    test: Test
    """Test that decides."""
    reason: str
    """Reason why the search ended."""
    factors_set_aside: tuple[FactorSetAside, ...] = ()
    """Factors of the user that were set aside, in that order."""
    whole: Solution | None = field(default=None, repr=False)
    """The adjustment of everything; None where it has no minimum."""
    look: Callable[[], Causes | None] | None = field(default=None, repr=False)
    """Looks for the causes of the misfits; none: they were not asked for before pickling."""

    def headline(self) -> str:
        """Return the numbers of observations and points set aside, and why the search ended."""
        factors = len(self.factors_set_aside)
        own = f", {factors} factors" if factors else ""
        return (
            f"Snooping: {len(self.rejected)} observations and {len(self.points_set_aside)} points"
            f"{own} set aside, {len(self.unresolved)} unresolved, σ̂0 {self.solution.sigma0:.4f}; "
            f"{self.reason}"
        )

    def first_rows(self) -> Rows:
        """Return the observations that were set aside."""
        return Rows(
            ("observation", "test value", "estimated error", "round"),
            ((r.label, r.test, r.estimated_error, r.round) for r in self.rejected),
            len(self.rejected),
        )

    @property
    def at_the_start(self) -> Literal["robust", "before"]:
        """What set observations aside before the first round: a robust adjustment, or the start."""
        return "robust" if any(r.number == 0 for r in self.rounds) else "before"

    @cached_property
    def causes(self) -> Causes | None:
        """What may have caused the misfits, the likeliest first; None where there are none."""
        return None if self.look is None else self.look()

    def __getstate__(self) -> dict[str, Any]:
        """Return the data for pickles: with the causes if they have been asked for."""
        return self.__dict__ | {"look": None}

    @property
    def ids_set_aside(self) -> tuple[str, ...]:
        """Ids of all observations set aside, the rays of removed points among them."""
        rays = (ray for p in self.points_set_aside for ray in p.rays)
        return (*(r.id for r in self.rejected), *rays)

    @property
    def network(self) -> Network:
        """The network without the observations that were set aside."""
        return self.solution.network
