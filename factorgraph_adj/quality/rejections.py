"""What data snooping found: observations set aside, points, what stays unresolved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..network.network import Network
from ..shown import Rows, Shown
from ..solve.solution import Solution
from .reliability import Reliability

Test = Literal["baarda", "pope"]
"""Baarda's w with σ0 = 1, or Pope's τ with the estimated one."""


@dataclass(frozen=True)
class Rejected:
    """An observation that was set aside."""

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name with the component of the largest test value, and the source."""
    component: str
    """Component with the largest test value, empty for scalar kinds."""
    test: float
    """Test value of that component, w or τ, in the adjustment with it."""
    estimated_error: float
    """Estimated gross error of that component, observed − true, in the adjustment with it."""
    round: int
    """Round in which it was set aside; 0: by the robust start."""
    final_error: float
    """Observed − computed from the clean solution; NaN where that does not determine it."""
    final_sigma: float
    """Standard deviation of ``final_error`` if there were no gross error, a-priori σ0 = 1."""
    final_test: float
    """Test value that it would have if it were put back into the clean solution: w or τ."""
    inseparable: tuple[tuple[str, float], ...]
    """Labels of what it could not be told from when it was set aside, with the correlations."""


@dataclass(frozen=True)
class Unresolved:
    """An observation that is still above the critical value, but stays in."""

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name with the component of the largest test value, and the source."""
    component: str
    """Component with the largest test value, empty for scalar kinds."""
    test: float
    """Test value, w or τ."""
    estimated_error: float
    """Estimated gross error, observed − true."""
    reason: str
    """Why it stays."""


@dataclass(frozen=True)
class PointSetAside:
    """A point that was taken out with all its rays."""

    name: str
    """Its name."""
    rays: tuple[str, ...]
    """Ids of its rays that went with it; others were rejected before."""
    label: str
    """The ray with the largest test value."""
    test: float
    """That test value, w or τ."""
    round: int
    """Round in which it was set aside; 0: by the robust start."""
    reason: str
    """Why it is the point that went."""


@dataclass(frozen=True)
class Round:
    """One adjustment of the search."""

    number: int
    """Number of the round."""
    sigma0: float
    """σ̂0 before the round sets anything aside."""
    largest: float
    """Largest |test value|."""
    suspects: int
    """Observations above the critical value."""
    set_aside: int
    """Observations that it set aside, those of points among them."""
    readmitted: int
    """Observations that it put back."""


@dataclass(frozen=True, eq=False, repr=False)
class Snooping(Shown):
    """What data snooping found."""

    solution: Solution
    """The adjustment without what was set aside."""
    reliability: Reliability
    """Its reliability, with α0 and power of the tests."""
    rejected: tuple[Rejected, ...]
    """What was set aside, in that order, but for the rays of points that went as a whole."""
    readmitted: tuple[str, ...]
    """Ids of what was put back because it fitted, whether or not it was rejected again."""
    points_set_aside: tuple[PointSetAside, ...]
    """Points that went with all their rays, since what was left of them determined nothing."""
    unresolved: tuple[Unresolved, ...]
    """What is still above the critical value but cannot be set aside."""
    rounds: tuple[Round, ...]
    """The rounds."""
    critical: float
    """Critical value of the last round."""
    test: Test
    """Which test."""
    reason: str
    """Why the search ended."""

    def headline(self) -> str:
        """Say what was found."""
        return (
            f"Snooping: {len(self.rejected)} observations and {len(self.points_set_aside)} points "
            f"set aside, {len(self.unresolved)} unresolved, σ̂0 {self.solution.sigma0:.4f}; "
            f"{self.reason}"
        )

    def first_rows(self) -> Rows:
        """Return what was set aside."""
        return Rows(
            ("observation", "test value", "estimated error", "round"),
            ((r.label, r.test, r.estimated_error, r.round) for r in self.rejected),
            len(self.rejected),
        )

    @property
    def network(self) -> Network:
        """The network without what was set aside."""
        return self.solution.network
