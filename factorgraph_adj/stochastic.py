"""Standard deviations of observations from the statements of makers and surveyors."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .errors import InputError
from .types import Array


@dataclass(frozen=True, slots=True)
class StandardDeviation:
    """Parts of the standard deviation of an observation.

    Lengths (S in metres):    σ² = (constant + ppm·10⁻⁶ S)² + centring_i² + centring_t²
    Levelling (L in km):      σ² = constant² + per_sqrt_km² L + centring_i² + centring_t²
    Directions, azimuths:     σ² = constant² + (centring_i² + centring_t²)/D²
    Vertical, zenith angles:  σ² = constant² + (centring_i² + centring_t²)/S²
    Angles j-i-k:             σ² = constant² + centring_i² D_jk²/(D_ij D_ik)²
                                   + centring_t² (1/D_ij² + 1/D_ik²)

    D are horizontal distances and S slope distances from the start coordinates; S of a length is
    the observed value.
    """

    constant: float = 0.0
    """Constant part, unit of the observation (metres, radians)."""
    ppm: float = 0.0
    """Part proportional to a distance, millionths."""
    per_sqrt_km: float = 0.0
    """Standard deviation of one kilometre of levelled line, metres."""
    centring_instrument: float = 0.0
    """Standard deviation of the centring of the instrument, metres."""
    centring_target: float = 0.0
    """Standard deviation of the centring of the target, metres."""

    def __post_init__(self) -> None:
        """Check that every part is finite and ≥ 0, and that at least one part is > 0."""
        parts = np.array(
            [
                self.constant,
                self.ppm,
                self.per_sqrt_km,
                self.centring_instrument,
                self.centring_target,
            ]
        )
        if not np.all(np.isfinite(parts)) or np.any(parts < 0) or not np.any(parts > 0):
            raise InputError(
                f"the parts of a standard deviation must be finite, not negative and not all "
                f"zero: {self}"
            )

    def scaled(self, by: float) -> StandardDeviation:
        """Return the standard deviation with every part multiplied by ``by``."""
        return StandardDeviation(*(by * getattr(self, f.name) for f in fields(self)))


def whitening(covariance: Array) -> Array:
    """Return W = L⁻¹ of a covariance Σ = L Lᵀ, so that W Σ Wᵀ = I.

    Raises:
        InputError: Σ is not square, finite, symmetric or positive definite.
    """
    sigma = np.asarray(covariance, dtype=float)
    if sigma.ndim != 2 or sigma.shape[0] != sigma.shape[1]:
        raise InputError(f"a covariance matrix must be square, not {sigma.shape}")
    if not np.all(np.isfinite(sigma)):
        raise InputError("a covariance matrix must be finite")
    scale = np.sqrt(np.abs(np.diag(sigma)))
    if np.any(np.diag(sigma) <= 0):
        raise InputError("a covariance matrix must have positive variances on its diagonal")
    correlation = sigma / np.outer(scale, scale)
    if np.max(np.abs(correlation - correlation.T)) > 1e-6:
        raise InputError("a covariance matrix must be symmetric")
    smallest = float(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0])
    if smallest < 1e-13:
        raise InputError(
            "the covariance matrix is not positive definite "
            f"(smallest eigenvalue of the correlations {smallest:.2e})"
        )
    factor = np.linalg.cholesky((correlation + correlation.T) / 2)
    return np.asarray(np.linalg.inv(factor) / scale[None, :])
