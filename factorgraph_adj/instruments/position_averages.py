"""Averages of GNSS positions over time, with a covariance that knows of their correlation.

Errors of positions at 1 Hz are no white noise: multipath and the atmosphere change within minutes.
They are taken for a Gauss–Markov process of first order with the correlation time τ: positions Δt
apart have the correlation ρ = exp(−Δt/τ). The average of n positions with covariances C_i is

    x̄ = N⁻¹ Σ C_i⁻¹ x_i,   N = Σ C_i⁻¹,   C̄ = f N⁻¹,   f = (1 + ρ) / (1 − ρ),

with ρ for the median interval of the positions; positions of one time, such as lines that came
twice, have one error, and count together as one. f is the sum of the correlations of a position
with all others of a long series, those of the neighbouring averages included. A network takes
averages as independent observations, and with f the mean of many of them has the right precision,
however short they are: with τ = 100 s and 1 Hz, f = 200, and averages of a minute have σ of
1.8 times that of one position, an hour of them 0.24 times. The covariance of a single average alone
would be smaller, at most that of one position; a test of one average against others is therefore
cautious for periods below 2 τ. Let the period be 2 τ or longer where single averages are to be
tested.

Source of the sum: M. B. Priestley, Spectral Analysis and Time Series (1981), section 5.3.2; of the
process for RTK positions: A. Amiri-Simkooei, C. Tiberius, Assessing receiver noise using GPS short
baseline time series, GPS Solutions 11 (2007), whose correlation times are of this order.

**Outliers**: positions that differ from the median of the period by more than the quantile
1 − `OUTLIER_ALPHA`/n of χ²(3), by their own covariances, are left out and counted: a wrong fix of
the ambiguities lasts a few seconds and is off by decimetres. If half of them or more are, the
period has no position, and that is told.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import InputError
from ..statistical_tests import chi2_upper_quantile
from ..types import Array
from .gnss_fixes import GnssFix, Quality
from .message_rules import AGREEING

OUTLIER_ALPHA = 0.001
"""Probability that a period without outliers loses a position."""
MIN_SHARE = 0.5
"""Smallest share of positions of a period that have to agree."""
METRES_OF_RADIAN = 6_378_137.0
"""Metres of a radian of latitude, for differences of positions within a period."""


def correlation_factor(interval: float, correlation_time: float) -> float:
    """Return f = (1 + ρ)/(1 − ρ) with ρ = exp(−interval/τ).

    >>> round(correlation_factor(1.0, 100.0), 2), correlation_factor(1.0, 0.0)
    (200.0, 1.0)

    Args:
        interval: seconds between positions.
        correlation_time: τ, seconds; 0: positions are independent.
    """
    if correlation_time <= 0.0:
        return 1.0
    return 1.0 / math.tanh(0.5 * interval / correlation_time)


@dataclass(frozen=True)
class PositionAverage:
    """The average of a period."""

    fix: GnssFix
    """Its position at the mean time, with its covariance; its quality is the lowest."""
    used: int
    """Number of positions."""
    outliers: int
    """Number of positions that were left out, as they disagree."""


def average_of(
    fixes: list[GnssFix], correlation_time: float, *, interval: float = math.inf
) -> PositionAverage:
    """Return the average of positions.

    Args:
        fixes: positions with covariances, all of them geodetic or all in a grid.
        correlation_time: τ, seconds; 0: positions are independent.
        interval: seconds to the next position if only one is used.

    Raises:
        InputError: there are none, they are of both sorts, a covariance is missing or not positive
            definite, or half of them disagree with their median.
    """
    if not fixes:
        raise InputError("no position in the period")
    if len({f.grid for f in fixes}) > 1:
        raise InputError("positions of a grid and geodetic ones stand in one period")
    if any(f.position is None or f.covariance is None for f in fixes):
        raise InputError("a position without a covariance cannot be averaged: send GST")
    first = np.array(fixes[0].position)
    metres = np.ones(3)
    if not fixes[0].grid:
        metres = METRES_OF_RADIAN * np.array([1.0, math.cos(first[0]), 0.0])
        metres[2] = 1.0
    # Rows along the position's own order; covariances are along east, north, up.
    order = [0, 1, 2] if fixes[0].grid else [1, 0, 2]
    off = np.array([f.position for f in fixes]) - first
    if not fixes[0].grid:
        off[:, 1] = np.remainder(off[:, 1] + math.pi, 2.0 * math.pi) - math.pi
    off *= metres
    covariances = np.array([f.covariance for f in fixes])[:, order][:, :, order]
    try:
        weights = np.linalg.inv(np.linalg.cholesky(covariances))
    except np.linalg.LinAlgError:
        raise InputError("a covariance of a position is not positive definite") from None
    weights = weights.transpose(0, 2, 1) @ weights
    v = off - np.median(off, axis=0)
    limit = float(chi2_upper_quantile(OUTLIER_ALPHA / len(fixes), 3.0))
    kept = np.einsum("ni,nij,nj->n", v, weights, v) <= limit
    if np.count_nonzero(kept) <= MIN_SHARE * len(fixes) and len(fixes) > 1:
        what = f"{np.count_nonzero(~kept)} of {len(fixes)} positions differ from their median"
        raise InputError(f"{what} by more than their standard deviations explain")
    normal = weights[kept].sum(axis=0)
    mean = np.linalg.solve(normal, np.einsum("nij,nj->i", weights[kept], off[kept]))
    times = np.array([f.time for f, k in zip(fixes, kept, strict=True) if k])
    instants = np.unique(times)
    if len(instants) > 1:
        interval = float(np.median(np.diff(instants)))
    factor = len(times) / len(instants) * correlation_factor(interval, correlation_time)
    covariance: Array = np.linalg.inv(normal) * factor
    position = first + mean / metres
    if not fixes[0].grid:
        position[1] = np.remainder(position[1] + math.pi, 2.0 * math.pi) - math.pi
    used = [f for f, k in zip(fixes, kept, strict=True) if k]
    ages = [f.age for f in used if f.age is not None]
    satellites = [f.satellites for f in used if f.satellites is not None]
    fix = replace(
        fixes[0],
        time=float(times.mean()),
        position=(float(position[0]), float(position[1]), float(position[2])),
        quality=min((f.quality for f in used), key=lambda q: GnssFix.RANKS[q]),
        satellites=min(satellites, default=None),
        age=max(ages, default=None),
        covariance=covariance[order][:, order],
    )
    return PositionAverage(fix, len(used), len(fixes) - len(used))


@dataclass
class PositionAverages:
    """Positions as they come, to an average for each period of UTC."""

    period: float = 60.0
    """Length of a period, seconds: from multiples of it since 1970; 0: every position is one."""
    correlation_time: float = 100.0
    """τ, seconds; 0: positions are independent."""
    least_quality: Quality = "fixed"
    """Lowest quality of a position that is used."""
    max_age: float = math.inf
    """Largest age of the corrections, seconds."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Number of positions that were not used, by the reason."""
    _fixes: list[GnssFix] = field(default_factory=list)
    """Positions of the present period."""
    _number: int | None = None
    """Number of the present period."""
    _late: int = 0
    """Number of positions of earlier periods that have come in a row."""

    def take(self, fix: GnssFix) -> PositionAverage | None:
        """Take a position; return the average of the period that it ends.

        Raises:
            InputError: the period that it ends has no average, see `average_of`, or what came
                before was ahead; the position is taken nevertheless.
        """
        if fix.position is None:
            self.left_out["without a position"] += 1
            return None
        if not fix.is_at_least(self.least_quality):
            self.left_out[f"quality {fix.quality}"] += 1
            return None
        if fix.age is not None and fix.age > self.max_age:
            self.left_out["old corrections"] += 1
            return None
        if self.period <= 0.0:
            return PositionAverage(fix, 1, 0)
        number = math.floor(fix.time / self.period)
        if self._number is not None and number < self._number:
            self._late += 1
            if self._late < AGREEING:
                self.left_out["late"] += 1
                return None
            # The time before was wrong, by a week for example, or the clock was set back.
            ahead, self._late = len(self._fixes), 0
            self.left_out["ahead"] += ahead
            self._fixes, self._number = [fix], number
            raise InputError(
                f"{ahead} positions are left out: their times were ahead of the {AGREEING} that "
                "came after them"
            )
        self._late = 0
        ended = self._number is not None and number > self._number
        before, self._number = self._fixes, number
        if not ended:
            before.append(fix)
            return None
        self._fixes = [fix]
        return self._average(before)

    def rest(self) -> PositionAverage | None:
        """Return the average of the period that has not ended; the stream has.

        Raises:
            InputError: it has no average, see `average_of`.
        """
        before, self._fixes, self._number = self._fixes, [], None
        return self._average(before) if before else None

    def _average(self, fixes: list[GnssFix]) -> PositionAverage:
        found = average_of(fixes, self.correlation_time, interval=self.period)
        if found.outliers:
            self.left_out["outliers"] += found.outliers
        return found
