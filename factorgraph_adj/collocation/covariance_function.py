"""Covariance functions of signals: isotropic, of a distance ρ on the ground or in the image.

C(ρ) = σ² ϱ(ρ/L), with the variance σ² of the signal and the length L:

    gaussian      exp(−q²)                            infinitely smooth
    exponential   exp(−q)                             continuous; first-order Gauss-Markov
    hirvonen      1 / (1 + q²)                        smooth, with a long tail (Moritz 1980, § 22)
    matern32      (1 + √3 q) exp(−√3 q)               one derivative
    matern52      (1 + √5 q + 5/3 q²) exp(−√5 q)      two derivatives
    wendland      (1 − q)⁴ (4 q + 1), 0 from q = 1    two derivatives, support L

All are positive definite in three dimensions. A variogram is γ(ρ) = C(0) − C(ρ). The practical
range of geostatistics, at which 5 % of the variance is left, is 3 L of ``exponential`` and √3 L of
``gaussian``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from ..constructors import ChecksArguments
from ..errors import InputError, Problem, known, similar
from ..types import Array


def _wendland(q: Array) -> Array:
    inside = np.maximum(1.0 - q, 0.0)
    return np.asarray(inside**4 * (4.0 * q + 1.0))


CORRELATION_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "gaussian": lambda q: np.exp(-(q**2)),
    "exponential": lambda q: np.exp(-q),
    "hirvonen": lambda q: 1.0 / (1.0 + q**2),
    "matern32": lambda q: (1.0 + sqrt(3) * q) * np.exp(-sqrt(3) * q),
    "matern52": lambda q: (1.0 + sqrt(5) * q + 5.0 / 3.0 * q**2) * np.exp(-sqrt(5) * q),
    "wendland": _wendland,
}
"""Correlation ϱ(q) of each kind, q = ρ/L ≥ 0."""


@dataclass(frozen=True)
class CovarianceFunction(metaclass=ChecksArguments):
    """Covariance function of a signal, C(ρ) = σ² ϱ(ρ/L).

    Raises:
        InputError: the kind is unknown, σ is negative, or L is not positive.
    """

    kind: str
    """Kind: gaussian, exponential, hirvonen, matern32, matern52 or wendland."""
    sigma: float
    """Standard deviation σ of the signal, in its unit; 0: there is no signal."""
    length: float
    """Length L, in the unit of the places."""

    def __post_init__(self) -> None:
        """Check the values."""
        check_kind(self.kind)
        problems = []
        if not (isfinite(self.sigma) and self.sigma >= 0):
            problems.append(Problem(f"sigma must be zero or greater, not {self.sigma}"))
        if not (isfinite(self.length) and self.length > 0):
            problems.append(Problem(f"length must be greater than zero, not {self.length}"))
        if problems:
            raise InputError(problems)

    def __call__(self, distance: Array | float) -> Array:
        """Return C(ρ) of distances of any shape."""
        q = np.asarray(distance, dtype=float) / self.length
        return np.asarray(self.sigma**2 * CORRELATION_FUNCTIONS[self.kind](q))

    def between(self, a: Array, b: Array | None = None) -> Array:
        """Return the covariances of the signal at places a (n, d) with that at b (m, d), (n, m).

        Without ``b`` they are those of the places a with one another.
        """
        return self(distances(a, a if b is None else b))

    def __str__(self) -> str:
        """Return kind, σ and L."""
        return self.text()

    def text(self, unit: str = "") -> str:
        """Return kind, σ and L, both in a unit."""
        after = f" {unit}" if unit else ""
        return f"{self.kind}, σ {self.sigma:.4g}{after}, L {self.length:.4g}{after}"


def check_kind(kind: str) -> None:
    """Raise InputError if a kind of covariance function is unknown."""
    if kind not in CORRELATION_FUNCTIONS:
        valid = known(CORRELATION_FUNCTIONS, most=len(CORRELATION_FUNCTIONS))
        hint = similar(str(kind), list(CORRELATION_FUNCTIONS))
        raise InputError(f"covariance function {kind!r} is unknown; valid: {valid}{hint}")


def distances(a: Array, b: Array) -> Array:
    """Return the distances between places a (n, d) and b (m, d), (n, m)."""
    from scipy.spatial.distance import cdist  # few need it, and its import takes long

    return np.asarray(cdist(a, b))
