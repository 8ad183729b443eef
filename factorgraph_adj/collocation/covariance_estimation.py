"""Estimation of covariance functions: empirical covariances, variogram, restricted likelihood.

By classes of distance, without the trend, with residuals w of its least-squares fit:

    Ĉ(ρ_k) = mean of w_i w_j,   γ̂(ρ_k) = mean of ½ (w_i − w_j)²      over the pairs of class k

The variogram σ_n² + σ² (1 − ϱ(ρ/L)) is fitted to γ̂, weighted by pairs; it gives start values. The
variance components σ² of the signal and σ_n² of the noise, and L, then maximise the restricted
likelihood: at its maximum the square sums equal their expectations, as in
`factorgraph_adj.quality.variance_components`,

    ŝᵀ C⁻¹ ŝ = tr(C P),   n̂ᵀ D⁻¹ n̂ = tr(D P)

(Patterson & Thompson 1971; Koch 1999, § 3.6). For a given L one diagonalisation of the contrasts
makes the likelihood a function of a number, so that the search cannot end in a local minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import TypeAlias

import numpy as np

from ..errors import InputError
from ..result_display import Rows, Shown
from ..statistical_tests import ALPHA_OF_MODEL
from ..types import Array
from .collocation import as_places
from .covariance_function import CORRELATION_FUNCTIONS, CovarianceFunction, check_kind, distances
from .signal_test import SignalTest, TrendContrasts, signal_test, trend_contrasts
from .trend import Trend

CLASSES = 12
"""Number of classes of distance up to half of the largest one."""
LENGTHS, RATIOS = 24, 41
"""Numbers of lengths, and of ratios of variances, that the search tries before it refines."""
RATIO_RANGE = (1e-6, 1e6)
"""Range of the variance of the signal relative to that of the noise."""
LEAST_NOISE = 1e-2
"""Estimated σ of the noise relative to that of the signal below which it counts as zero: the
likelihood is flat there."""
REFINEMENTS = 40
"""Number of steps of a golden section; they reduce the interval by 5e-9."""
LOG_STEP = 1e-3
"""Step of the logarithms of the parameters in second differences of the likelihood."""
StatedNoise: TypeAlias = float | Array | None
"""σ of the noise; None: it is estimated."""


@dataclass(frozen=True, repr=False)
class EmpiricalCovariance(Shown):
    """Empirical covariances and variogram by classes of distance."""

    distances: Array
    """Mean distance of the pairs of each class, (k,)."""
    pairs: Array
    """Number of pairs of each class, (k,)."""
    covariances: Array
    """Ĉ(ρ_k), (k,)."""
    semivariances: Array
    """γ̂(ρ_k), (k,)."""
    variance: float
    """Ĉ(0): mean square of the residuals of the trend, signal and noise together."""

    def headline(self) -> str:
        """Return the number of classes and the variance."""
        return f"EmpiricalCovariance: {len(self.pairs)} classes, variance {self.variance:.4g}"

    def first_rows(self) -> Rows:
        """Return the classes."""
        figures = (self.distances, self.pairs, self.covariances, self.semivariances)
        rows = zip(*(map(float, f) for f in figures), strict=True)
        return Rows(("distance", "pairs", "covariance", "semivariance"), rows, len(self.pairs))


@dataclass(frozen=True, repr=False)
class CovarianceEstimate(Shown):
    """Estimated covariance function and noise."""

    function: CovarianceFunction
    """Covariance function of the signal."""
    noise: float | Array
    """σ of the noise: as it was stated, or estimated."""
    log_sigmas: Array
    """Standard deviations of ln σ, ln L and, where it was estimated, ln σ_n; NaN where the
    likelihood has no maximum within the bounds."""
    likelihood: float
    """Logarithm of the restricted likelihood, without its constant."""
    without_signal: float
    """The same without a signal."""
    test: SignalTest
    """Moran's test of the values."""
    remarks: tuple[str, ...]
    """What the places do not determine, as sentences."""

    def headline(self) -> str:
        """Return the function, the noise and remarks."""
        said = "".join(f"; {remark}" for remark in self.remarks)
        noise = f"{self.noise:.4g}" if np.ndim(self.noise) == 0 else "as stated"
        return f"CovarianceEstimate: {self.function}, noise {noise}{said}"


def empirical_covariance(
    places: Array,
    observed: Array,
    *,
    trend: str = "mean",
    classes: int = CLASSES,
    max_distance: float | None = None,
) -> EmpiricalCovariance:
    """Return the empirical covariances and the variogram by classes of distance.

    Args:
        places: coordinates of the places, (n, d).
        observed: observed values, (n, c) or (n,), NaN where not observed; components are pooled.
        trend: trend that is taken out by least squares, as for `collocate`.
        classes: number of classes of equal width; empty ones are left out.
        max_distance: end of the last class; by default half of the largest distance, beyond which
            few and dependent pairs are left.

    Raises:
        InputError: there are too few values, or no pair is near enough.
    """
    where, values = as_places(places), np.asarray(observed, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    left = _detrended(where, values, trend)
    apart, products, halves = [], [], []
    for k in range(left.shape[1]):
        on = np.isfinite(left[:, k])
        p, w = where[on], left[on, k]
        i, j = np.triu_indices(len(p), 1)
        apart.append(distances(p, p)[i, j])
        products.append(w[i] * w[j])
        halves.append(0.5 * (w[i] - w[j]) ** 2)
    rho, product, half = (np.concatenate(x) for x in (apart, products, halves))
    end = max_distance if max_distance is not None else 0.5 * float(rho.max(initial=0.0))
    if not end > 0 or classes < 1:
        raise InputError("classes and max_distance must be greater than zero, and places differ")
    number = np.floor(rho / end * classes).astype(np.intp)
    on = number < classes
    count = np.bincount(number[on], minlength=classes).astype(float)
    filled = count > 0
    if not filled.any():
        raise InputError(f"no two places are nearer to each other than {end:.4g}")

    def mean(x: Array) -> Array:
        sums = np.bincount(number[on], weights=x[on], minlength=classes)
        return np.asarray(sums[filled] / count[filled])

    variance = float(np.nanmean(left**2))
    return EmpiricalCovariance(mean(rho), count[filled], mean(product), mean(half), variance)


def _detrended(places: Array, values: Array, trend: str) -> Array:
    """Return the residuals of a least-squares fit of the trend, (n, c)."""
    on = np.isfinite(values)
    design = Trend.of(trend, places[on.any(axis=1)], values.shape[1]).design(places)
    out = np.full(values.shape, np.nan)
    a, told = design[on], values[on]
    if len(told) <= a.shape[1]:
        raise InputError(f"{len(told)} values are too few for the trend {trend!r}")
    x = np.linalg.lstsq(a, told, rcond=None)[0] if a.shape[1] else np.zeros(0)
    out[on] = told - a @ x
    return out


def fit_variogram(found: EmpiricalCovariance, kind: str) -> tuple[CovarianceFunction, float]:
    """Fit σ_n² + σ² (1 − ϱ(ρ/L)) to a variogram, weighted by pairs, both variances ≥ 0.

    Args:
        found: the empirical variogram.
        kind: kind of covariance function.

    Returns:
        The covariance function of the signal, and σ_n of the noise.
    """
    from scipy.optimize import nnls  # few need it, and its import takes long

    check_kind(kind)
    root = np.sqrt(found.pairs)
    best = (np.inf, 1.0, np.zeros(2))
    for length in np.geomspace(0.2 * found.distances[0], 3.0 * found.distances[-1], 5 * LENGTHS):
        shape = 1.0 - CORRELATION_FUNCTIONS[kind](found.distances / length)
        columns = np.column_stack([np.ones_like(shape), shape]) * root[:, None]
        x, misfit = nnls(columns, found.semivariances * root)
        if misfit < best[0]:
            best = (float(misfit), float(length), x)
    _, length, (nugget, sill) = best
    return CovarianceFunction(kind, float(np.sqrt(sill)), length), float(np.sqrt(nugget))


def estimate_covariance(
    places: Array,
    observed: Array,
    *,
    kind: str = "gaussian",
    noise: StatedNoise = None,
    trend: str = "mean",
    length: float | None = None,
    alpha: float = ALPHA_OF_MODEL,
) -> CovarianceEstimate:
    """Estimate σ and L of a covariance function, and the noise, by restricted likelihood.

    Args:
        places: coordinates of the places, (n, d).
        observed: observed values, (n, c) or (n,), NaN where not observed. All components have the
            same function; call it once for each where they differ.
        kind: kind of covariance function.
        noise: σ of the noise, which counts as known: one number, one of each component or value as
            for `collocate`, but no covariance of all values; None: one σ is estimated.
        trend: trend, as for `collocate`.
        length: L, if it is known.
        alpha: probability with which the test finds a signal where there is none; 1: a signal is
            taken for granted.

    Raises:
        InputError: Moran's test finds no signal, so that a collocation would smooth noise; there
            are too few values; or the noise is not positive.
    """
    check_kind(kind)
    own = 1.0 if noise is None else noise
    test = signal_test(places, observed, noise=own, trend=trend, alpha=min(alpha, 1 - 1e-12))
    if not test.has_signal:
        raise InputError(
            f"the values have no signal that noise does not explain ({test.headline()}): no "
            "covariance function follows from them; state one, or a larger alpha"
        )
    contrasts = trend_contrasts(places, observed, noise=own, trend=trend)
    search = _Likelihood(contrasts, kind, noise is None)
    remarks = []
    if length is None:
        low, high = _length_bounds(contrasts.places)
        length = search.best_length(low, high)
        if length <= 1.05 * low:
            remarks.append("L is shorter than the places are apart: they do not determine it")
        elif length >= 0.95 * high:
            remarks.append("L is longer than the area is large: the places do not determine it")
    sigma, scale, likelihood = search.at(length)
    if sigma == 0.0:
        remarks.append("the estimated variance of the signal is zero")
    elif noise is None and scale < LEAST_NOISE * sigma:
        remarks.append("no noise can be told from the signal: its estimated variance is zero")
    without = search.without_signal()
    log_sigmas = search.log_sigmas(sigma, length, scale)
    function = CovarianceFunction(kind, sigma, length)
    found = scale if noise is None else noise
    return CovarianceEstimate(
        function, found, log_sigmas, likelihood, without, test, tuple(remarks)
    )


def _length_bounds(places: tuple[Array, ...]) -> tuple[float, float]:
    """Return half of the median distance to the nearest place, and twice the largest distance."""
    largest = max(places, key=len)
    apart = distances(largest, largest)
    far = float(apart.max())
    np.fill_diagonal(apart, np.inf)
    near = float(np.median(apart.min(axis=1)))
    return max(0.5 * near, 1e-3 * far), 2.0 * far


@dataclass(frozen=True)
class _Likelihood:
    """Restricted likelihood of the contrasts z, with variances φ (1 + τ λ_i(L)), φ τ = σ²."""

    contrasts: TrendContrasts
    """Contrasts of the values."""
    kind: str
    """Kind of covariance function."""
    scaled: bool
    """Whether the factor φ of the noise is estimated, otherwise it is 1."""

    def diagonal(self, length: float) -> tuple[Array, Array]:
        """Return the variances λ of the signal with σ = 1, and the contrasts along them."""
        unit = CovarianceFunction(self.kind, 1.0, length)
        values, vectors = np.linalg.eigh(self.contrasts.quadratic_form(unit.between))
        return np.maximum(values, 0.0), vectors.T @ self.contrasts.values

    def at(self, length: float) -> tuple[float, float, float]:
        """Return σ, the σ of the noise, and the logarithm of the likelihood at its maximum."""
        lam, z = self.diagonal(length)

        def minus(log_ratio: float) -> float:
            return -self._value(lam, z, float(np.exp(log_ratio)), None)[1]

        low, high = (float(np.log(r)) for r in RATIO_RANGE)
        grid = np.linspace(low, high, RATIOS)
        grid = grid - np.log(max(float(lam.mean()), 1e-300))
        if not self.scaled:
            grid = grid + np.log(max(float(np.mean(z**2)), 1e-300))
        ratio = float(np.exp(_minimum(minus, grid)))
        phi, value = self._value(lam, z, ratio, None)
        none = self._value(lam, z, 0.0, None)
        if none[1] >= value:
            return 0.0, float(np.sqrt(none[0])), none[1]
        return float(np.sqrt(phi * ratio)), float(np.sqrt(phi)), value

    def best_length(self, low: float, high: float) -> float:
        """Return the length with the largest likelihood between two bounds."""
        return float(
            np.exp(
                _minimum(
                    lambda t: -self.at(float(np.exp(t)))[2],
                    np.linspace(np.log(low), np.log(high), LENGTHS),
                    steps=REFINEMENTS // 2,
                )
            )
        )

    def without_signal(self) -> float:
        """Return the logarithm of the likelihood without a signal."""
        z = self.contrasts.values
        return self._value(np.zeros_like(z), z, 0.0, None)[1]

    def log_sigmas(self, sigma: float, length: float, scale: float) -> Array:
        """Return standard deviations of ln σ, ln L, ln σ_n from second differences at the maximum.

        The inverse of the observed information; NaN where it is not positive definite.
        """
        k = 3 if self.scaled else 2
        if sigma == 0.0:
            return np.full(k, np.nan)
        begin = np.log([sigma, length, scale])[:k]
        diagonals = {s: self.diagonal(length * np.exp(s * LOG_STEP)) for s in (-1, 0, 1)}

        def value(*steps: int) -> float:
            lam, z = diagonals[steps[1]]
            at = np.exp(begin + LOG_STEP * np.array(steps))
            phi = at[2] ** 2 if self.scaled else 1.0
            return -self._value(lam, z, at[0] ** 2 / phi, phi)[1]

        information = np.zeros((k, k))
        for i in range(k):
            for j in range(i + 1):
                e, f = np.eye(k, dtype=int)[i], np.eye(k, dtype=int)[j]
                if i == j:
                    second = value(*e) - 2.0 * value(*(0 * e)) + value(*-e)
                else:
                    both = value(*(e + f)) + value(*(-e - f))
                    second = 0.5 * (both - value(*(e - f)) - value(*(f - e))) / 2.0
                information[i, j] = information[j, i] = second / LOG_STEP**2
        try:
            np.linalg.cholesky(information)
        except np.linalg.LinAlgError:
            return np.full(k, np.nan)
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))

    def _value(self, lam: Array, z: Array, ratio: float, phi: float | None) -> tuple[float, float]:
        """Return the factor φ of the noise and the logarithm of the likelihood."""
        variance = 1.0 + ratio * lam
        if phi is None:
            phi = float(np.mean(z**2 / variance)) if self.scaled else 1.0
        phi = max(phi, 1e-300)
        sums = np.sum(np.log(phi * variance)) + np.sum(z**2 / variance) / phi
        return phi, -0.5 * float(sums)


def _minimum(function: Callable[[float], float], grid: Array, *, steps: int = REFINEMENTS) -> float:
    """Return the place of the minimum of a function on a grid, refined by a golden section."""
    values = [function(float(t)) for t in grid]
    best = int(np.argmin(values))
    low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
    golden = 0.5 * (sqrt(5.0) - 1.0)
    a, b = high - golden * (high - low), low + golden * (high - low)
    fa, fb = function(a), function(b)
    for _ in range(steps):
        if fa <= fb:
            high, b, fb = b, a, fa
            a = high - golden * (high - low)
            fa = function(a)
        else:
            low, a, fa = a, b, fb
            b = low + golden * (high - low)
            fb = function(b)
    return a if fa <= fb else b
