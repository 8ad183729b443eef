"""Least-squares collocation ℓ = A x + s + n: trend, signal and noise; prediction anywhere.

With the covariance C of the signal s, D of the noise n, and C̄ = C + D (Moritz 1980, Advanced
Physical Geodesy, § 16; FRAMES F16):

    x̂ = Q Aᵀ C̄⁻¹ ℓ,   Q = (Aᵀ C̄⁻¹ A)⁻¹               trend
    ŝ_p = C_ps C̄⁻¹ (ℓ − A x̂)                         signal, filtered at p = s, predicted elsewhere
    n̂ = ℓ − A x̂ − ŝ                                  noise
    Σ(ŝ_p − s_p) = C_pp − C_ps C̄⁻¹ C_sp + C_ps C̄⁻¹ A Q Aᵀ C̄⁻¹ C_sp

The prediction of trend and signal together is universal kriging. With P = C̄⁻¹ − C̄⁻¹ A Q Aᵀ C̄⁻¹,
n̂ = D P ℓ and ŝ = C P ℓ, the reliability of the observations is

    r = diag(D P), r_s = diag(C P),  Σ r + Σ r_s = n − u     redundancy numbers of noise and signal
    ε_i = (P ℓ)_i / P_ii,  σ(ε_i) = 1/√P_ii                  leave-one-out error (Dubrule 1983)
    w_i = ε_i / σ(ε_i),    ∇_i = δ0/√P_ii                    test, and smallest detectable error

w_i is Baarda's test of observation i with the covariance C̄. Components at a place have covariance
functions of their own and no cross-covariance; a trend may join them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from ..result_display import Rows, Shown
from ..stochastic_model import whitening
from ..types import Array, Index, Mask
from .covariance_function import CovarianceFunction, distances
from .trend import Trend

SignalCovariance: TypeAlias = CovarianceFunction | Sequence[CovarianceFunction | None] | None
"""Covariance function of all components, or of each; None: no signal."""
PredictedPart: TypeAlias = Literal["sum", "signal", "trend"]
"""What is predicted: trend and signal together, or one of them."""
MIN_CONTROL = 1e-10
"""Smallest P_ii C̄_ii of an observation that others control; rounding leaves about 1e-13."""
MIN_TREND_PIVOT = 1e-10
"""Smallest pivot of the trend relative to its largest one."""


@dataclass(frozen=True, repr=False)
class Prediction(Shown):
    """Predicted values at places, with their standard deviations."""

    places: Array
    """Places, (m, d)."""
    values: Array
    """Predicted values, (m, c)."""
    covariances: Array
    """Covariance of the errors of prediction of the components at each place, (m, c, c)."""

    @property
    def sigmas(self) -> Array:
        """Standard deviations of the errors of prediction, (m, c)."""
        return np.asarray(np.sqrt(np.einsum("mcc->mc", self.covariances)))

    def headline(self) -> str:
        """Return how many places there are."""
        return f"Prediction at {len(self.values)} places"

    def first_rows(self) -> Rows:
        """Return places, values and standard deviations."""
        d, c = self.places.shape[1], self.values.shape[1]
        header = [*"xyz"[:d], *(f"value {i + 1}" for i in range(c))]
        header += [f"σ {i + 1}" for i in range(c)]
        cells = np.hstack([self.places, self.values, self.sigmas])
        return Rows(header, (tuple(map(float, row)) for row in cells), len(cells))


@dataclass(frozen=True)
class _Component:
    """The observations of one component, whitened: W C̄ Wᵀ = I."""

    on: Index
    """Numbers of the places where it is observed, n_k."""
    function: CovarianceFunction | None
    """Covariance function of its signal."""
    signal: Array
    """C, (n_k, n_k)."""
    noise: Array
    """D, (n_k, n_k)."""
    whitening: Array
    """W, (n_k, n_k)."""
    design: Array
    """W A, (n_k, u)."""
    observed: Array
    """W ℓ, (n_k,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Collocation(Shown):
    """A least-squares collocation; arrays (n, c) are NaN where a component is not observed."""

    names: tuple[str, ...]
    """Names of the places, n."""
    places: Array
    """Places, (n, d)."""
    observed: Array
    """Observed values ℓ, (n, c)."""
    functions: tuple[CovarianceFunction | None, ...]
    """Covariance function of each component."""
    trend: Trend
    """Trend; its coefficients are those of places centred and scaled as it says."""
    coefficients: Array
    """Estimated coefficients x̂ of the trend, (u,)."""
    cofactors: Array
    """Their covariance Q, (u, u)."""
    vtpv: float
    """ℓᵀ P ℓ, distributed as χ² with n − u degrees of freedom for the right covariances."""
    redundancy: int
    """Number of observed values minus that of coefficients, n − u."""
    _components: tuple[_Component, ...] = field(repr=False)

    @property
    def sigma0(self) -> float:
        """√(ℓᵀPℓ/(n − u)), a priori 1; NaN without redundancy."""
        return float(np.sqrt(self.vtpv / self.redundancy)) if self.redundancy > 0 else np.nan

    def headline(self) -> str:
        """Return numbers, covariance functions and σ̂0."""
        signals = "; ".join("no signal" if f is None else str(f) for f in self.functions)
        return (
            f"Collocation of {len(self.places)} places, {self.observed.shape[1]} components "
            f"({signals}), trend {self.trend.kind}, redundancy {self.redundancy}, "
            f"σ̂0 {self.sigma0:.4f}"
        )

    def first_rows(self) -> Rows:
        """Return the figures of the first component at each place."""
        values = [self.observed, self.signal, self.noise]
        columns = [*values, self.redundancy_numbers, self.leave_one_out, self.test_values]
        return Rows(
            ("place", "ℓ", "signal", "noise", "r", "left out", "w"),
            ((name, *(float(c[i, 0]) for c in columns)) for i, name in enumerate(self.names)),
            len(self.names),
        )

    def predict(self, places: Array, *, part: PredictedPart = "sum") -> Prediction:
        """Predict at places (m, d), or (m,) of one coordinate.

        Args:
            places: coordinates in the axes and unit of the observed places.
            part: ``sum`` of trend and signal, as in kriging; ``signal`` or ``trend`` alone.

        Raises:
            InputError: the places have other dimensions, or ``part`` is unknown.
        """
        where, values, by_trend, transfers = self._prediction(places, part)
        covariances = np.einsum("mcu,mdu->mcd", by_trend, by_trend)
        for k, (function, transfer) in enumerate(zip(self.functions, transfers, strict=True)):
            if function is not None and part != "trend":
                variance = function.sigma**2 - np.sum(transfer**2, axis=1)
                # At a place that is observed without noise rounding leaves less than nothing.
                covariances[:, k, k] += np.maximum(variance, 0.0)
        return Prediction(where, values, covariances)

    def prediction_covariance(self, places: Array, *, part: PredictedPart = "sum") -> Array:
        """Return the joint covariance of the errors of prediction at places, (m c, m c).

        Its order is place by place, and at each place component by component.

        Args:
            places: as for `predict`.
            part: as for `predict`.

        Raises:
            InputError: as `predict`.
        """
        where, values, by_trend, transfers = self._prediction(places, part)
        m, c = values.shape
        flat = by_trend.reshape(m * c, -1)
        joint = (flat @ flat.T).reshape(m, c, m, c)
        for k, (function, transfer) in enumerate(zip(self.functions, transfers, strict=True)):
            if function is not None and part != "trend":
                joint[:, k, :, k] += function.between(where) - transfer @ transfer.T
        return joint.reshape(m * c, m * c)

    def _prediction(
        self, places: Array, part: PredictedPart
    ) -> tuple[Array, Array, Array, list[Array]]:
        """Return places, values, (A_p − C_ps C̄⁻¹ A) √Q of the part, and C_ps Wᵀ of components."""
        parts = ("sum", "signal", "trend")
        if part not in parts:
            raise InputError(f"part must be one of {known(parts)}, not {part!r}")
        where = as_places(places)
        if where.shape[1] != self.places.shape[1]:
            what = f"places must have {self.places.shape[1]} coordinates, not {where.shape[1]}"
            raise InputError(what)
        design = self.trend.design(where)
        if part == "signal":
            design = np.zeros_like(design)
        values = design @ self.coefficients
        transfers = []
        for k, c in enumerate(self._components):
            transfer = np.zeros((len(where), len(c.on)))
            if c.function is not None and part != "trend":
                transfer = c.function.between(where, self.places[c.on]) @ c.whitening.T
            values[:, k] += transfer @ (c.observed - c.design @ self.coefficients)
            design[:, k] -= transfer @ c.design
            transfers.append(transfer)
        return where, values, design @ _root(self.cofactors), transfers

    @cached_property
    def signal(self) -> Array:
        """Filtered signal ŝ at the observed places, (n, c)."""
        return self._spread([c.signal @ p for c, p in zip(self._components, self._pl, strict=True)])

    @cached_property
    def noise(self) -> Array:
        """Estimated noise n̂ = ℓ − A x̂ − ŝ, observed − predicted, (n, c)."""
        return self._spread([c.noise @ p for c, p in zip(self._components, self._pl, strict=True)])

    @cached_property
    def redundancy_numbers(self) -> Array:
        """Redundancy numbers r = diag(D P): share of an error that its noise estimate shows."""
        return self._of_p(lambda c, p: np.einsum("ij,ji->i", c.noise, p))

    @cached_property
    def signal_redundancy_numbers(self) -> Array:
        """Redundancy numbers of the signal, r_s = diag(C P): share that the signal takes."""
        return self._of_p(lambda c, p: np.einsum("ij,ji->i", c.signal, p))

    @cached_property
    def leave_one_out_sigmas(self) -> Array:
        """Standard deviations of the leave-one-out errors; infinite where nothing controls."""

        def sigma(c: _Component, p: Array) -> Array:
            own = np.diag(p)
            on = own * np.diag(c.signal + c.noise) > MIN_CONTROL
            return np.where(on, 1.0 / np.sqrt(np.where(on, own, 1.0)), np.inf)

        return self._of_p(sigma)

    @cached_property
    def leave_one_out(self) -> Array:
        """Leave-one-out errors: observed − predicted from all others; NaN without control."""
        sigma = self.leave_one_out_sigmas
        return np.where(np.isinf(sigma), np.nan, self._spread(self._pl) * sigma**2)

    @property
    def test_values(self) -> Array:
        """Test values w = ε/σ(ε), normal with variance 1 for the right covariances."""
        return self.leave_one_out / self.leave_one_out_sigmas

    def minimal_detectable_bias(self, delta0: float) -> Array:
        """Return the smallest detectable error ∇ = δ0 σ(ε) of each observation, (n, c)."""
        return delta0 * self.leave_one_out_sigmas

    @cached_property
    def _pl(self) -> list[Array]:
        """P ℓ of each component."""
        return [
            c.whitening.T @ (c.observed - c.design @ self.coefficients) for c in self._components
        ]

    def _of_p(self, figure: Callable[[_Component, Array], Array]) -> Array:
        """Return a figure of a component and its block of P, spread over all places."""
        root = _root(self.cofactors)
        out = []
        for c in self._components:
            by_trend = c.whitening.T @ (c.design @ root)
            out.append(figure(c, c.whitening.T @ c.whitening - by_trend @ by_trend.T))
        return self._spread(out)

    def _spread(self, parts: Sequence[Array]) -> Array:
        """Return values of the observed places of each component as (n, c), NaN elsewhere."""
        out = np.full(self.observed.shape, np.nan)
        for k, (c, part) in enumerate(zip(self._components, parts, strict=True)):
            out[c.on, k] = part
        return out


def collocate(
    places: Array,
    observed: Array,
    *,
    covariance: SignalCovariance,
    noise: float | Array = 0.0,
    trend: str = "mean",
    names: Sequence[str] | None = None,
) -> Collocation:
    """Separate observed values into trend, signal and noise; see the module for the formulas.

    Args:
        places: coordinates of the places, (n, d); (n,) for one coordinate.
        observed: observed values, (n, c); (n,) for one component. NaN: not observed there.
        covariance: covariance function of the signal of all components, or of each component; None
            for a component without signal, which then needs noise. σ is in the unit of the values,
            L in that of the places.
        noise: standard deviation of the noise, in the unit of the values: one number, one of each
            component (c,), or of each value (n, c), (n,) for one component; or, for one component,
            the covariance of all values, (n, n).
        trend: ``none``, ``mean``, ``plane`` or ``similarity``, see
            `factorgraph_adj.collocation.trend`.
        names: names of the places; by default their numbers from 1.

    Raises:
        InputError: shapes do not agree, a value is infinite, the observations do not determine the
            trend, or C + D is singular: two values at one place need noise.
    """
    where, values = as_places(places), np.asarray(observed, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    problems = []
    if values.ndim != 2 or len(values) != len(where):
        what = f"{len(where)} places need as many rows of values, not shape {values.shape}"
        raise InputError(what)
    n, c = values.shape
    if np.isinf(values).any() or not np.isfinite(where).all():
        problems.append(Problem("places must be finite, and values finite or NaN"))
    if names is not None and len(names) != n:
        problems.append(Problem(f"{n} places need as many names, not {len(names)}"))
    functions = _functions(covariance, c, problems)
    noises = _noises(noise, np.isfinite(values), problems)
    if problems:
        raise InputError(problems)
    labels = tuple(names) if names is not None else tuple(str(i + 1) for i in range(n))
    seen = np.isfinite(values).any(axis=1)
    if not seen.any():
        raise InputError("no value is observed")
    shape = Trend.of(trend, where[seen], c)
    design = shape.design(where)
    components = []
    for k in range(c):
        on = np.flatnonzero(np.isfinite(values[:, k]))
        function = functions[k]
        own = noises[k][np.ix_(on, on)]
        signal = np.zeros_like(own) if function is None else function.between(where[on])
        try:
            white = whitening(signal + own) if len(on) else np.zeros((0, 0))
        except InputError as error:
            raise InputError(_singular(where[on], [labels[i] for i in on], error)) from None
        columns, told = white @ design[on, k], white @ values[on, k]
        components.append(_Component(on, function, signal, own, white, columns, told))
    return _solved(labels, where, values, functions, shape, tuple(components))


def _solved(
    names: tuple[str, ...],
    places: Array,
    observed: Array,
    functions: tuple[CovarianceFunction | None, ...],
    trend: Trend,
    components: tuple[_Component, ...],
) -> Collocation:
    """Return the collocation of whitened components.

    Raises:
        InputError: the trend is not determined.
    """
    design = np.vstack([c.design for c in components])
    told = np.concatenate([c.observed for c in components])
    n, u = design.shape
    q, r = np.linalg.qr(design)
    pivots = np.abs(np.diag(r))
    if n < u or (u and pivots.min() <= MIN_TREND_PIVOT * pivots.max()):
        raise InputError(
            f"{n} values do not determine the {u} coefficients of the trend {trend.kind!r}: take a "
            "simpler one, or add places that do not lie on a line"
        )
    x = np.linalg.solve(r, q.T @ told) if u else np.zeros(0)
    root = np.linalg.inv(r) if u else np.zeros((0, 0))
    left = told - design @ x
    vtpv = float(left @ left)
    return Collocation(
        names, places, observed, functions, trend, x, root @ root.T, vtpv, n - u, components
    )


def as_places(places: Array) -> Array:
    """Return places as (n, d).

    Raises:
        InputError: they are no such array, or have more than three coordinates.
    """
    where = np.asarray(places, dtype=float)
    where = where[:, None] if where.ndim == 1 else where
    if where.ndim != 2 or not 1 <= where.shape[1] <= 3:
        raise InputError(f"places must be (n, d) with 1 to 3 coordinates, not {where.shape}")
    return where


def _root(cofactors: Array) -> Array:
    """Return R of Q = R Rᵀ."""
    return np.asarray(np.linalg.cholesky(cofactors), dtype=float) if len(cofactors) else cofactors


def _functions(
    covariance: SignalCovariance, c: int, problems: list[Problem]
) -> tuple[CovarianceFunction | None, ...]:
    if covariance is None or isinstance(covariance, CovarianceFunction):
        return (covariance,) * c
    found = tuple(covariance)
    if len(found) != c or not all(f is None or isinstance(f, CovarianceFunction) for f in found):
        what = f"covariance must be one CovarianceFunction, or one of each of {c} components"
        problems.append(Problem(f"{what}, not {covariance!r}"))
    return found


def _noises(noise: float | Array, on: Mask, problems: list[Problem]) -> list[Array]:
    """Return the covariance of the noise of each component, (n, n); ``on``: what is observed."""
    n, c = on.shape
    given = np.asarray(noise, dtype=float)
    if given.shape == (n, n) and c == 1 and n > 1:
        return [given]
    try:
        sigma = sigmas_of_noise(given, (n, c))
    except InputError as error:
        problems += error.problems
        return []
    if not (np.isfinite(sigma) & (sigma >= 0))[on].all():
        problems.append(Problem("the σ of noise must be zero or greater"))
    return [np.diag(sigma[:, k] ** 2) for k in range(c)]


def sigmas_of_noise(noise: float | Array, shape: tuple[int, int]) -> Array:
    """Return σ of the noise of each value, of the shape (n, c) of the values.

    Raises:
        InputError: it is neither one number, nor one of each component or value.
    """
    given = np.asarray(noise, dtype=float)
    n, c = shape
    try:
        return np.broadcast_to(given[:, None] if given.shape == (n,) and c == 1 else given, shape)
    except ValueError:
        what = f"noise must be σ, or σ of shape ({c},) or ({n}, {c})"
        raise InputError(f"{what}, not an array of shape {given.shape}") from None


def _singular(places: Array, names: list[str], error: InputError) -> str:
    """Return why C + D is singular: the two nearest places."""
    if len(places) < 2:
        return f"a component has neither signal nor noise: {error}"
    apart = distances(places, places)
    np.fill_diagonal(apart, np.inf)
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return (
        f"the covariance of signal and noise is singular: {names[i]!r} and {names[j]!r} are "
        f"{apart[i, j]:.3g} apart; state noise of the observations, or leave one of them out"
    )
