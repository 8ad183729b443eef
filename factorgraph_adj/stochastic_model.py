"""Standard deviations of parts (constant, ppm, √km, centring); whitening of covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal, TypeAlias

import numpy as np

from .constructors import ChecksArguments
from .errors import InputError
from .types import Array

Combine: TypeAlias = Literal["mixed", "linear", "quadratic"]
"""How the parts of a standard deviation combine, see `StandardDeviation`."""
COMBINATIONS: tuple[Combine, ...] = ("mixed", "linear", "quadratic")
PARTS = (
    *("ppm", "per_sqrt_km", "centring_instrument", "centring_target"),
    *("vertical_instrument", "vertical_target"),
)
"""Attributes of `StandardDeviation` for the parts that are not constant."""


@dataclass(frozen=True, slots=True)
class StandardDeviation(metaclass=ChecksArguments):
    """Parts of the standard deviation of an observation, and how they combine.

    Each part has an effect on the observation. S is a slope distance and D a horizontal distance,
    metres, z a zenith angle, L the length of a levelled line, km, c_i and c_t the centring of
    instrument and target, v_i and v_t that of their heights:

    | observation | reading | beside it |
    | --- | --- | --- |
    | slope distance | constant; ppm·10⁻⁶ S | √(c_i² sin² z + v_i² cos² z); c_t, v_t as c_i, v_i |
    | horizontal distance | constant; ppm·10⁻⁶ D | c_i; c_t |
    | levelled height difference | constant | per_sqrt_km √L |
    | direction, azimuth | constant | c_i/D; c_t/D |
    | vertical, zenith angle | constant | √(c_i² cos² z + v_i² sin² z)/S; as before with c_t, v_t |
    | angle j-i-k | constant | c_i D_jk/(D_ij D_ik); c_t √(1/D_ij² + 1/D_ik²) |

    A centring moves its end of the sight, and the observation changes by the component of that
    movement along the sight, or across it. Where no v is stated, it is the c of its end: the
    centring is the same in all directions, and its effects are c and c/S whatever z is.

    With the effects a, b … of the reading and c, e … of what is beside it:

        mixed:      σ² = (a + b + …)² + c² + e² + …
        linear:     σ = a + b + … + c + e + …
        quadratic:  σ² = a² + b² + … + c² + e² + …

    For a distance without centring, mixed and linear are σ = constant + ppm·10⁻⁶ S, as makers
    state it, and quadratic is σ² = constant² + (ppm·10⁻⁶ S)². S of a length is the observed value;
    other lengths are those of the adjusted coordinates. A levelled height has no centring, since a
    level stands anywhere: an observation refuses parts that have no effect on it.
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
    combine: Combine = "mixed"
    """How the effects of the parts combine."""
    vertical_instrument: float | None = None
    """Standard deviation of the height of the instrument, metres; None: that of its centring."""
    vertical_target: float | None = None
    """Standard deviation of the height of the target, metres; None: that of its centring."""

    def __post_init__(self) -> None:
        """Check that every part is finite and ≥ 0, one > 0, and that the combination is known."""
        if self.combine not in COMBINATIONS:
            valid = ", ".join(COMBINATIONS)
            raise InputError(f"unknown combination {self.combine!r} of parts; valid: {valid}")
        given = [getattr(self, name) for name in ("constant", *PARTS)]
        parts = [value for value in given if value is not None]
        if not all(map(isfinite, parts)) or min(parts) < 0 or not max(parts) > 0:
            raise InputError(
                f"the parts of a standard deviation must be finite, not negative and not all "
                f"zero: {self}"
            )

    def scaled(self, by: float) -> StandardDeviation:
        """Return the standard deviation with every part multiplied by ``by``."""
        parts = {n: getattr(self, n) for n in ("constant", *PARTS)}
        return replace(self, **{n: by * v for n, v in parts.items() if v is not None})


def whitening(covariance: Array) -> Array:
    """Return W = L⁻¹ of a covariance Σ = L Lᵀ, so that W Σ Wᵀ = I.

    Raises:
        InputError: Σ is not square, finite, symmetric or positive definite.
    """
    sigma = np.asarray(covariance, dtype=float)
    if sigma.ndim != 2 or sigma.shape[0] != sigma.shape[1]:
        raise InputError(f"a covariance matrix must be square, not {sigma.shape}")
    return np.asarray(whitenings(sigma[None])[0])


def whitenings(covariances: Array) -> Array:
    """Return W of covariances of equal size (n, d, d), see `whitening`.

    Raises:
        InputError: one of them is not finite, symmetric or positive definite.
    """
    if not np.isfinite(covariances).all():
        raise InputError("a covariance matrix must be finite")
    variances = np.einsum("nii->ni", covariances)
    if (variances <= 0).any():
        raise InputError("a covariance matrix must have positive variances on its diagonal")
    scale = np.sqrt(variances)
    correlation = covariances / (scale[:, :, None] * scale[:, None, :])
    turned = correlation.transpose(0, 2, 1)
    if (np.abs(correlation - turned) > 1e-6).any():
        raise InputError("a covariance matrix must be symmetric")
    mean = 0.5 * (correlation + turned)
    smallest = float(np.linalg.eigvalsh(mean)[:, 0].min(initial=1.0))
    if smallest < 1e-13:
        raise InputError(
            "the covariance matrix is not positive definite "
            f"(smallest eigenvalue of the correlations {smallest:.2e})"
        )
    return np.asarray(np.linalg.inv(np.linalg.cholesky(mean)) / scale[:, None, :])
