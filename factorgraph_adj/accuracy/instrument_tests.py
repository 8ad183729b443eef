"""Field tests of instruments by ISO 17123: levels (2), theodolites (3), distance meters (4).

Full test procedures; every function returns the experimental standard deviation s with its degrees
of freedom ν, from readings in SI units, and `InstrumentTest` has the statistical tests:

    part 2, level: two series of n = 20 pairs of readings to staves 60 m apart, the staves exchanged
        between them; s for 1 km of double levelling, ν = 2 (n − 1) = 38
    part 3, directions: m = 4 series of n = 3 sets of t = 5 targets in two faces; s of a direction
        observed in both faces, ν = m (n − 1)(t − 1) = 32
    part 3, zenith angles: m = 4, n = 3, t = 4; s of a zenith angle observed in both faces,
        ν = m (n − 1) t = 32
    part 4, distance meter: all distances of p = 7 points on a line; s of a distance,
        ν = p (p − 1)/2 − p = 14

Tests at the probability 1 − α = 0.95 (ISO 17123-1, 7):

    a) s ≤ σ √(χ²_{1−α}(ν) / ν)                     s agrees with a stated σ
    b) 1/F_{1−α/2}(ν, ν̃) ≤ s²/s̃² ≤ F_{1−α/2}(ν, ν̃)   two samples agree
    c) |δ| ≤ s_δ t_{1−α/2}(ν)                       a systematic value δ does not differ from 0

Sources: ISO 17123-2:2001, 5 to 7; ISO 17123-3:2001, 6 to 8; ISO 17123-4:2012, 6 to 8. The examples
of their annexes are not public: tests compare with an independent least squares adjustment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError, Problem
from ..models.base import wrap
from ..result_display import Rows, Shown
from ..statistical_tests import chi2_quantile, fisher_quantile, student_quantile
from ..types import Array

ALPHA = 0.05
"""1 − probability of the tests of ISO 17123."""
LEVELLING_DISTANCE_M = 60.0
"""Distance between the staves of ISO 17123-2, metres."""


@dataclass(frozen=True)
class Offset:
    """A systematic value of a test: difference of staves, zero correction, index error."""

    name: str
    """What it is."""
    value: float
    """Its value, SI."""
    sigma: float
    """Its experimental standard deviation, SI."""
    freedom: int
    """Degrees of freedom of it."""

    @property
    def limit(self) -> float:
        """Largest |value| that does not differ from zero, s_δ t."""
        return self.sigma * student_quantile(1 - ALPHA / 2, self.freedom)

    @property
    def is_zero(self) -> bool:
        """Whether it does not differ significantly from zero (test c)."""
        return abs(self.value) <= self.limit


@dataclass(frozen=True, repr=False)
class InstrumentTest(Shown):
    """Result of a field test."""

    standard: str
    """Standard and quantity: ``ISO 17123-3, horizontal directions``."""
    s: float
    """Experimental standard deviation, SI: radians, metres, or metres per √km."""
    freedom: int
    """Degrees of freedom ν."""
    of_series: tuple[float, ...] = ()
    """Standard deviation of each series, SI."""
    offsets: tuple[Offset, ...] = ()
    """Systematic values."""
    residuals: Array = field(default_factory=lambda: np.zeros(0))
    """Residuals, SI, in the shape of the readings."""

    def limit(self, sigma: float) -> float:
        """Return the largest s that agrees with a stated σ, σ √(χ²(ν)/ν) (test a)."""
        return sigma * math.sqrt(chi2_quantile(1 - ALPHA, self.freedom) / self.freedom)

    def agrees_with(self, sigma: float) -> bool:
        """Return whether s is not significantly larger than a stated σ (test a)."""
        return self.s <= self.limit(sigma)

    def agrees_with_test(self, other: InstrumentTest) -> bool:
        """Return whether two tests have the same standard deviation (test b).

        Raises:
            InputError: the other is a test of another quantity.
        """
        if other.standard != self.standard:
            raise InputError(f"{self.standard} is not compared with {other.standard}")
        bound = fisher_quantile(1 - ALPHA / 2, self.freedom, other.freedom)
        low = fisher_quantile(ALPHA / 2, self.freedom, other.freedom)
        return low <= self.s**2 / other.s**2 <= bound

    def headline(self) -> str:
        """Return s and its degrees of freedom."""
        return f"InstrumentTest: {self.standard}, s {self.s:.4g}, {self.freedom} degrees of freedom"

    def first_rows(self) -> Rows:
        """Return the systematic values with their limits."""
        return Rows(
            ("value", "estimate", "s", "limit", "zero"),
            [
                (o.name, o.value, o.sigma, o.limit, "yes" if o.is_zero else "no")
                for o in self.offsets
            ],
            len(self.offsets),
        )


def level_test(
    first: Array, second: Array, *, distance: float = LEVELLING_DISTANCE_M
) -> InstrumentTest:
    """Evaluate the full test of a level, ISO 17123-2.

    With d = reading A − reading B, series 1 and, with the staves exchanged, series 2:

        r_j = mean(d) − d_j within each series,  s = √(Σ r² / ν),  ν = n₁ + n₂ − 2
        s_LEV = s / √2 · √(1 km / distance)      for 1 km of double levelling
        δ = mean(d₁) − mean(d₂),  s_δ = s √(1/n₁ + 1/n₂)

    Args:
        first: readings A and B of the pairs of series 1, (n, 2) metres; the standard has n = 20.
        second: those of series 2.
        distance: distance between the staves, metres.

    Raises:
        InputError: the arrays have other shapes, or numbers that are not finite.
    """
    series = [_checked(a, (None, 2), name) for a, name in ((first, "first"), (second, "second"))]
    d = [a[:, 0] - a[:, 1] for a in series]
    residuals = [v.mean() - v for v in d]
    freedom = sum(len(v) - 1 for v in d)
    s = math.sqrt(sum(float(r @ r) for r in residuals) / freedom)
    n = [len(v) for v in d]
    zero = Offset(
        "difference of the zeros of the staves",
        float(d[0].mean() - d[1].mean()),
        s * math.sqrt(1 / n[0] + 1 / n[1]),
        freedom,
    )
    to_km = math.sqrt(1000.0 / distance / 2.0)
    return InstrumentTest(
        "ISO 17123-2, 1 km of double levelling",
        s * to_km,
        freedom,
        tuple(to_km * math.sqrt(float(r @ r) / (len(r) - 1)) for r in residuals),
        (zero,),
        np.concatenate(residuals),
    )


def direction_test(readings: Array) -> InstrumentTest:
    """Evaluate the full test of horizontal directions, ISO 17123-3, 7.

    Means of both faces, reduced to the first target, x_jk of set j and target k, x̄_k their means
    over the sets of a series:

        d_jk = x̄_k − x_jk,  r_jk = d_jk − mean over k of d_jk
        s_i = √(Σ r² / ((n − 1)(t − 1))),  s = √(Σ s_i² / m)

    Args:
        readings: horizontal readings, (m series, n sets, t targets, 2 faces) radians; the standard
            has (4, 3, 5, 2).

    Raises:
        InputError: the array has another shape, or numbers that are not finite.
    """
    x = _checked(readings, (None, None, None, 2), "readings", least=(1, 2, 2, 2))
    means = _face_means(x[..., 0], x[..., 1] - math.pi)
    reduced = wrap(means - means[:, :, :1])
    reduced = reduced[:, :1] + wrap(reduced - reduced[:, :1])
    d = reduced.mean(axis=1, keepdims=True) - reduced
    r = d - d.mean(axis=2, keepdims=True)
    m, n, t = r.shape
    own = np.sqrt(np.sum(r**2, axis=(1, 2)) / ((n - 1) * (t - 1)))
    return InstrumentTest(
        "ISO 17123-3, horizontal directions",
        float(np.sqrt(np.mean(own**2))),
        m * (n - 1) * (t - 1),
        tuple(own.tolist()),
        (),
        r,
    )


def zenith_test(readings: Array) -> InstrumentTest:
    """Evaluate the full test of zenith angles, ISO 17123-3, 8.

    Of readings z_I and z_II, z = (z_I − z_II + 2π) / 2 and the index error δ = (z_I + z_II − 2π)/2:

        r_jk = z̄_k − z_jk,  s_i = √(Σ r² / ((n − 1) t)),  s = √(Σ s_i² / m)

    Args:
        readings: zenith readings, (m series, n sets, t targets, 2 faces) radians; the standard has
            (4, 3, 4, 2).

    Raises:
        InputError: the array has another shape, or numbers that are not finite.
    """
    z = _checked(readings, (None, None, None, 2), "readings", least=(1, 2, 1, 2))
    means = (z[..., 0] - z[..., 1] + 2 * math.pi) / 2.0
    index = (z[..., 0] + z[..., 1] - 2 * math.pi) / 2.0
    r = means.mean(axis=1, keepdims=True) - means
    m, n, t = r.shape
    own = np.sqrt(np.sum(r**2, axis=(1, 2)) / ((n - 1) * t))
    s_index = float(np.std(index, ddof=1)) / math.sqrt(index.size)
    return InstrumentTest(
        "ISO 17123-3, zenith angles",
        float(np.sqrt(np.mean(own**2))),
        m * (n - 1) * t,
        tuple(own.tolist()),
        (Offset("index error", float(index.mean()), s_index, index.size - 1),),
        r,
    )


def distance_meter_test(distances: Array) -> InstrumentTest:
    """Evaluate the full test of a distance meter, ISO 17123-4, 7: distances of points on a line.

    Unknown are the p − 1 distances of neighbours and the zero correction δ, by least squares with
    equal weights:

        x_ij + δ = Σ_{k=i}^{j−1} d_k + v_ij,  s = √(vᵀv / ν),  ν = p (p − 1)/2 − p,
        s_δ = s √Q_δδ

    Args:
        distances: horizontal distances of all pairs i < j of points, metres, corrected for
            atmosphere, in a (p, p) matrix above its diagonal; the standard has p = 7.

    Raises:
        InputError: fewer than 4 points, another shape, or numbers that are not finite.
    """
    d = np.asarray(distances, dtype=float)
    p = len(d)
    i, j = np.triu_indices(p, 1)
    if d.shape != (p, p) or p < 4 or not np.isfinite(d[i, j]).all():
        what = f"must be a matrix of the distances of 4 points at least, not of shape {d.shape}"
        raise InputError(Problem(what, "distances"))
    k = np.arange(p - 1)
    a = np.column_stack([(k >= i[:, None]) & (k < j[:, None]), -np.ones(len(i))]).astype(float)
    x, *_ = np.linalg.lstsq(a, d[i, j], rcond=None)
    v = a @ x - d[i, j]
    freedom = len(v) - p
    s = math.sqrt(float(v @ v) / freedom)
    cofactor = float(np.linalg.inv(a.T @ a)[-1, -1])
    out = np.zeros((p, p))
    out[i, j] = v
    zero = Offset("zero correction", float(x[-1]), s * math.sqrt(cofactor), freedom)
    return InstrumentTest("ISO 17123-4, distances", s, freedom, (), (zero,), out)


def _checked(
    given: Array, shape: tuple[int | None, ...], name: str, least: tuple[int, ...] | None = None
) -> Array:
    """Return an array of a shape, None for any size of 2 and more.

    Raises:
        InputError: it has another shape, or numbers that are not finite.
    """
    out = np.asarray(given, dtype=float)
    small = least or tuple(2 if n is None else n for n in shape)
    fits = out.ndim == len(shape) and all(
        have == n or (n is None and have >= low)
        for have, n, low in zip(out.shape, shape, small, strict=True)
    )
    if not fits or not np.isfinite(out).all():
        sizes = ", ".join(
            f"{low} or more" if n is None else str(n) for n, low in zip(shape, small, strict=True)
        )
        what = f"must be finite numbers of the shape ({sizes}), not {out.shape}"
        raise InputError(Problem(what, name))
    return out


def _face_means(first: Array, second: Array) -> Array:
    """Return means of angles in two faces; the second may differ by turns."""
    return first + wrap(second - first) / 2.0
