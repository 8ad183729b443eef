"""Test whether values at places have a signal at all: are neighbours alike? Moran's I.

With the values ℓ, whitened by their noise, the projection M that takes out the trend, and the
weights W of neighbours,

    I = (n / Σ W) zᵀ W z / zᵀ z,   z = M D⁻½ ℓ,   W = D⁻½ (w_ij) D⁻½

which is scale-free: it needs no σ of the noise, only its ratios (Moran 1950, Biometrika 37, 17–23;
of residuals Cliff & Ord 1981). w_ij = 1 where j is one of the `NEIGHBOURS` nearest places of i, and
½ if i is not one of those of j. P(I ≥ observed) without signal is that of a ratio of quadratic
forms of normal variables, exactly, by Imhof's integral (Biometrika 48, 1961, 419–426).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..result_display import Shown
from ..statistical_tests import ALPHA_OF_MODEL
from ..types import Array
from .collocation import as_places, sigmas_of_noise
from .covariance_function import distances
from .trend import Trend

NEIGHBOURS = 4
"""Number of nearest places that count as neighbours; all others where there are fewer."""
LEAST_EIGENVALUE = 1e-12
"""Eigenvalues of the quadratic form below this multiple of the largest one count as zero."""


@dataclass(frozen=True, repr=False)
class SignalTest(Shown):
    """Moran's test of a signal, of all components together."""

    moran: float
    """Moran's I."""
    expected: float
    """Its expectation without a signal."""
    probability: float
    """Probability of this I, or a larger one, without a signal."""
    alpha: float
    """Probability with which the test finds a signal where there is none."""
    freedom: int
    """Degrees of freedom: number of values minus that of the coefficients of the trend."""

    @property
    def has_signal(self) -> bool:
        """Whether neighbours are more alike than noise lets them be."""
        return self.probability < self.alpha

    def headline(self) -> str:
        """Return what the test found."""
        found = "neighbours are alike" if self.has_signal else "no signal: it would smooth noise"
        return (
            f"Moran's I {self.moran:.3f}, {self.expected:.3f} without a signal, probability "
            f"{self.probability:.3g}: {found}"
        )


def signal_test(
    places: Array,
    observed: Array,
    *,
    noise: float | Array = 1.0,
    trend: str = "mean",
    alpha: float = ALPHA_OF_MODEL,
) -> SignalTest:
    """Test whether neighbouring values are alike, beyond a trend: Moran's I.

    The test is one-sided: a signal makes values of neighbours alike, I large. Neighbours are the
    `NEIGHBOURS` (4) nearest places of each.

    Args:
        places: coordinates of the places, (n, d).
        observed: observed values, (n, c) or (n,), NaN where not observed.
        noise: standard deviation of each value, up to a common factor: one number, one of each
            component or value as for `collocate`, but no covariance of all values.
        trend: trend that is taken out, as for `collocate`.
        alpha: probability with which the test finds a signal where there is none (0.05).

    Raises:
        InputError: alpha is not between 0 and 1, fewer than 3 places, or too few values for the
            trend.
    """
    if not 0 < alpha < 1:
        raise InputError(f"alpha must lie between 0 and 1, not {alpha}")
    contrasts = trend_contrasts(places, observed, noise=noise, trend=trend)
    if min(len(p) for p in contrasts.places) < 3:
        raise InputError("a test of a signal needs at least 3 places of each component")
    weights = contrasts.quadratic_form(_neighbours)
    own = zip(contrasts.places, contrasts.sigmas, strict=True)
    total = sum(float((1.0 / s) @ _neighbours(p) @ (1.0 / s)) for p, s in own)
    z, scale = contrasts.values, contrasts.n / total
    ratio = float(z @ weights @ z / (z @ z)) if (z @ z) > 0 else 0.0
    eigenvalues = np.asarray(np.linalg.eigvalsh(weights), dtype=float)
    probability = upper_probability_of_form(eigenvalues - ratio)
    return SignalTest(scale * ratio, scale * float(eigenvalues.mean()), probability, alpha, len(z))


def _neighbours(places: Array) -> Array:
    """Return the symmetric weights W of neighbours, (n, n)."""
    n = len(places)
    apart = distances(places, places)
    np.fill_diagonal(apart, np.inf)
    k = min(NEIGHBOURS, n - 1)
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :k]
    w = np.zeros((n, n))
    w[np.arange(n)[:, None], nearest] = 1.0
    return 0.5 * (w + w.T)


def upper_probability_of_form(weights: Array) -> float:
    """Return P(Σ λ_i z_i² > 0) of independent standard normal z_i, by Imhof's integral.

    ½ + (1/π) ∫₀^∞ sin θ(u) / (u ρ(u)) du,  θ = ½ Σ atan(λ_i u),  ρ = Π (1 + λ_i² u²)^¼.

    Args:
        weights: λ, (n,).
    """
    from scipy.integrate import quad  # few need it, and its import takes long

    size = float(np.abs(weights).max(initial=0.0))
    if size == 0.0 or (weights <= 0).all() or (weights >= 0).all():
        return float((weights > 0).any())
    w = weights[np.abs(weights) > LEAST_EIGENVALUE * size] / size

    def integrand(t: float) -> float:
        # u = t / (1 − t) maps the half line on (0, 1).
        u = t / (1.0 - t)
        angle = 0.5 * float(np.arctan(w * u).sum())
        damping = 0.25 * float(np.log1p((w * u) ** 2).sum())
        return float(np.sin(angle) * np.exp(-damping)) / (t * (1.0 - t))

    integral, _ = quad(integrand, 0.0, 1.0, limit=200)
    return float(np.clip(0.5 + integral / np.pi, 0.0, 1.0))


@dataclass(frozen=True)
class TrendContrasts:
    """Whitened values without their trend: N D⁻½ ℓ, with N A = 0 and N Nᵀ = I."""

    places: tuple[Array, ...]
    """Places of each component."""
    sigmas: tuple[Array, ...]
    """σ of the noise there."""
    values: Array
    """Contrasts z, (n − u,): of noise alone they are independent with variance 1."""
    transfers: tuple[Array, ...]
    """Matrix from the values of each component to the contrasts, (n − u, n_k)."""
    n: int
    """Number of values."""

    def quadratic_form(self, of_component: Callable[[Array], Array]) -> Array:
        """Return Σ_k T_k F(places_k) T_kᵀ of the contrasts, (n − u, n − u).

        Args:
            of_component: F, a function of places (n_k, d) that returns a symmetric (n_k, n_k).
        """
        parts = (
            t @ of_component(p) @ t.T for p, t in zip(self.places, self.transfers, strict=True)
        )
        return np.asarray(sum(parts))


def trend_contrasts(
    places: Array, observed: Array, *, noise: float | Array, trend: str
) -> TrendContrasts:
    """Return the contrasts of values without their trend.

    Args:
        places: coordinates of the places, (n, d).
        observed: observed values, (n, c) or (n,), NaN where not observed.
        noise: standard deviation of the noise, greater than zero; as for `collocate`.
        trend: trend, as for `collocate`.

    Raises:
        InputError: the noise is not positive, or there are too few values for the trend.
    """
    where, values = as_places(places), np.asarray(observed, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2 or len(values) != len(where):
        raise InputError(f"{len(where)} places need as many rows of values, not {values.shape}")
    sigma = sigmas_of_noise(noise, (len(values), values.shape[1]))
    on = np.isfinite(values)
    if not on.any() or not (sigma[on] > 0).all():
        raise InputError("values are needed, and a σ of their noise greater than zero")
    design = Trend.of(trend, where[on.any(axis=1)], values.shape[1]).design(where)
    columns = [np.flatnonzero(on[:, k]) for k in range(values.shape[1])]
    white = np.vstack([design[i, k] / sigma[i, k][:, None] for k, i in enumerate(columns)])
    told = np.concatenate([values[i, k] / sigma[i, k] for k, i in enumerate(columns)])
    n, u = white.shape
    if n <= u:
        raise InputError(f"{n} values are too few for the {u} coefficients of the trend {trend!r}")
    # The last n − u columns of a full Q span what is orthogonal to the trend.
    null = np.linalg.qr(white, mode="complete")[0][:, u:].T
    transfers, first = [], 0
    places_of = tuple(where[i] for i in columns)
    own = tuple(sigma[i, k] for k, i in enumerate(columns))
    for k, i in enumerate(columns):
        transfers.append(null[:, first : first + len(i)] / sigma[i, k])
        first += len(i)
    return TrendContrasts(places_of, own, null @ told, tuple(transfers), n)
