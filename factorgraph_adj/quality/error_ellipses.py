"""Confidence ellipses, ellipsoids and height intervals, of places and of their differences.

The covariance Σ of a place, or of the difference of two places, is rotated into the local horizon
(east, north, up, `Frame.basis` without deflections); relative figures lie in the horizon of the
midpoint. An ellipse is the 2-D confidence region of the plan position, an ellipsoid the 3-D
confidence region of the position:

    semi-axes = k √λ, λ the eigenvalues of Σ

with k = 1 for standard ellipses, and at a confidence p (`confidence_factor`)

    σ0 known            k² = χ²_{p; dim}
    σ̂0 of r redundant   k² = dim · F_{p; dim, r}

Azimuths count clockwise from north, in [0, π): an axis has no direction. The dip of an axis is
positive if it points down in the direction of its azimuth. Two axes of the same length have
arbitrary azimuths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..errors import InputError, taking
from ..frames import Frame
from ..models.base import within
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION, chi2_quantile, fisher_quantile
from ..types import Array
from .point_precision import Place, place_covariance, place_covariances, place_position

FIXED_AXIS_VARIANCE_RATIO = 1e-13
"""Variance of an axis, relative to the largest, up to which it is rounding and the axis is held."""
ROUNDING_COMPONENT = 1e-12
"""Component of a unit vector up to which it is rounding and counts as zero."""
PlacePairs: TypeAlias = Sequence[tuple[Place, Place | None]]
"""Places, each with the second one of a difference or None."""


def confidence_factor(
    dimension: int, confidence: float | None, *, redundancy: int | None = None
) -> float:
    """Return k, the semi-axes of a confidence region divided by those of the standard region.

    Args:
        dimension: 1 for an interval, 2 for an ellipse, 3 for an ellipsoid: k = 1.960, 2.448 and
            2.795 at 95 %.
        confidence: probability p with which the region covers the truth; None: k = 1.
        redundancy: r of the estimated σ̂0 that scales the covariance, k = √(dim F_{p; dim, r});
            None: σ0 is known, k = √χ²_{p; dim}.

    Raises:
        InputError: a probability outside (0, 1), no redundancy.
    """
    if confidence is None:
        return 1.0
    if not 0 < confidence < 1:
        raise InputError(f"the confidence must lie between 0 and 1, or be none, not {confidence}")
    if redundancy is None:
        return float(np.sqrt(chi2_quantile(confidence, dimension)))
    if redundancy < 1:
        raise InputError(f"σ̂0 needs redundant observations, not {redundancy}")
    return float(np.sqrt(dimension * fisher_quantile(confidence, dimension, redundancy)))


def solution_confidence_factor(
    solution: Solution, dimension: int, confidence: float | None
) -> float:
    """Return the `confidence_factor` for the variance factor that a solution uses."""
    return confidence_factor(dimension, confidence, redundancy=_redundancy_of(solution))


def _redundancy_of(solution: Solution) -> int | None:
    """Return r of the σ̂0 that scales the covariances of a solution; None where σ0 is known."""
    estimated = solution.variance == "a-posteriori" and solution.redundancy > 0
    return solution.redundancy if estimated else None


@dataclass(frozen=True)
class ConfidenceInterval:
    """Interval of a height or height difference."""

    a: Place
    """Place of the height."""
    b: Place | None
    """Place from which the height difference to ``a`` is taken; None: height itself."""
    sigma: float
    """Standard deviation along the plumb line, metres."""
    confidence: float | None
    """Probability of the interval ± `half_width`; None: standard deviation."""
    factor: float
    """Factor k = half width / σ."""

    @property
    def half_width(self) -> float:
        """Half width, metres."""
        return self.factor * self.sigma


@dataclass(frozen=True)
class ErrorEllipse:
    """Confidence ellipse of a plan position, or of the difference of two positions."""

    a: Place
    """Place of the ellipse."""
    b: Place | None
    """Second place of a relative ellipse; None for an absolute ellipse."""
    centre: Array
    """Adjusted position, or the midpoint of two, (3,) metres in the frame of the network."""
    semi_axes: tuple[float, float]
    """Semi-major and semi-minor axis, metres; zero for a held axis."""
    azimuth: float
    """Azimuth of the semi-major axis, clockwise from north, [0, π); 0 for a circle."""
    confidence: float | None
    """Probability; None for a standard ellipse."""
    factor: float
    """Factor k = semi-axes / semi-axes of the standard ellipse."""


@dataclass(frozen=True)
class ErrorEllipsoid:
    """Confidence ellipsoid of a place, or of the difference of two places."""

    a: Place
    """Place of the ellipsoid."""
    b: Place | None
    """Second place of a relative ellipsoid; None for an absolute ellipsoid."""
    centre: Array
    """Adjusted position, or the midpoint of two, (3,) metres in the frame of the network."""
    semi_axes: tuple[float, float, float]
    """Semi-axes, metres, in descending order; zero for a held axis."""
    azimuths: tuple[float, float, float]
    """Azimuth of each axis, clockwise from north, [0, π); 0 for a vertical axis."""
    dips: tuple[float, float, float]
    """Angle of each axis below the horizon in the direction of its azimuth, (−π/2, π/2]."""
    directions: Array
    """Unit vectors of the axes in the frame of the network, rows (3, 3)."""
    confidence: float | None
    """Probability; None for a standard ellipsoid."""
    factor: float
    """Factor k = semi-axes / semi-axes of the standard ellipsoid."""


@taking(Solution)
def error_ellipse(
    solution: Solution,
    a: Place,
    b: Place | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> ErrorEllipse:
    """Return the error ellipse of the plan position of a place, or of the difference of two places.

    Args:
        solution: an adjusted network.
        a: name of a point, or ``("pose", name)`` for the projection centre of a photo.
        b: a second place, for the ellipse of the difference X_b − X_a with all
            cross-covariances; None: absolute ellipse.
        confidence: probability of the region; None: standard ellipse. In an a-posteriori
            solution the factor allows for the redundancy of σ̂0.

    Raises:
        InputError: unknown names, two identical places, confidence outside (0, 1).
    """
    return solution_ellipses(solution, *_one(solution, a, b), confidence)[0]


@taking(Solution)
def error_ellipsoid(
    solution: Solution,
    a: Place,
    b: Place | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> ErrorEllipsoid:
    """Return the error ellipsoid of a place, or of a difference; arguments of `error_ellipse`."""
    return _ellipsoids(solution, *_one(solution, a, b), confidence)[0]


def error_ellipses(
    solution: Solution,
    places: Sequence[Place] | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> tuple[ErrorEllipse, ...]:
    """Return the error ellipses of many places at once, from the selected inverse.

    Args:
        solution: an adjusted network.
        places: names of points, ``("pose", name)`` for projection centres; None: all points.
        confidence: as in `error_ellipse`.

    Raises:
        InputError: unknown names, all at once; confidence outside (0, 1).
    """
    return solution_ellipses(solution, *_many(solution, places), confidence)


def error_ellipsoids(
    solution: Solution,
    places: Sequence[Place] | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> tuple[ErrorEllipsoid, ...]:
    """Return the error ellipsoids of many places; arguments of `error_ellipses`."""
    return _ellipsoids(solution, *_many(solution, places), confidence)


def height_interval(
    solution: Solution,
    a: Place,
    b: Place | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> ConfidenceInterval:
    """Return the confidence interval of a height, or of a height difference X_b − X_a.

    σ² = uᵀ Σ u; u points up in the horizon of the place or of the midpoint. The factor k is that of
    one dimension.

    Args and errors as in `error_ellipse`.
    """
    return _intervals(solution, *_one(solution, a, b), confidence)[0]


def height_intervals(
    solution: Solution,
    places: Sequence[Place] | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> tuple[ConfidenceInterval, ...]:
    """Return the confidence intervals of many heights; arguments of `error_ellipses`."""
    return _intervals(solution, *_many(solution, places), confidence)


# -- helpers --------------------------------------------------------------------------------------


def _one(solution: Solution, a: Place, b: Place | None) -> tuple[PlacePairs, Array, Array]:
    """Return the place or pair, its centre (1, 3) and covariance (1, 3, 3)."""
    sigma = place_covariance(solution, a, b)
    centre = place_position(solution, a)
    if b is not None:
        centre = (centre + place_position(solution, b)) / 2.0
    return [(a, b)], centre[None], sigma[None]


def _many(solution: Solution, places: Sequence[Place] | None) -> tuple[PlacePairs, Array, Array]:
    """Return the places, their positions (n, 3) and covariances (n, 3, 3)."""
    if places is None:
        names = solution.equations.unknowns["point"].names
        pairs: PlacePairs = [(name, None) for name in names]
        return pairs, solution.state["point"], solution.point_covariances
    if isinstance(places, str):
        raise InputError(f"places must be a list, not the one name {places!r}")
    sigma = place_covariances(solution, places)
    centres = np.array([place_position(solution, p) for p in places]).reshape(-1, 3)
    return [(p, None) for p in places], centres, sigma


def _in_horizon(frame: Frame, centres: Array, sigma: Array) -> tuple[Array, Array]:
    """Return covariances (n, 3, 3) in east, north, up, and the axes as rows (n, 3, 3)."""
    enu = frame.basis(centres, np.zeros((len(centres), 2))).enu
    return enu @ sigma @ enu.transpose(0, 2, 1), enu


def _intervals(
    solution: Solution, pairs: PlacePairs, centres: Array, sigma: Array, confidence: float | None
) -> tuple[ConfidenceInterval, ...]:
    factor = solution_confidence_factor(solution, 1, confidence)
    sigmas = np.sqrt(
        np.maximum(_in_horizon(solution.network.frame, centres, sigma)[0][:, 2, 2], 0.0)
    )
    return tuple(
        ConfidenceInterval(a, b, s, confidence, factor)
        for (a, b), s in zip(pairs, sigmas.tolist(), strict=True)
    )


def solution_ellipses(
    solution: Solution, pairs: PlacePairs, centres: Array, sigma: Array, confidence: float | None
) -> tuple[ErrorEllipse, ...]:
    """Return error ellipses of places, or of differences of two, whose covariances are known.

    Args:
        solution: an adjusted network.
        pairs: the n places, each with a second one or None.
        centres: positions, or midpoints (n, 3), metres.
        sigma: covariances (n, 3, 3), metres².
        confidence: as in `error_ellipse`.
    """
    frame, redundancy = solution.network.frame, _redundancy_of(solution)
    return frame_ellipses(frame, pairs, centres, sigma, confidence, redundancy=redundancy)


def frame_ellipses(
    frame: Frame,
    pairs: PlacePairs,
    centres: Array,
    sigma: Array,
    confidence: float | None,
    *,
    redundancy: int | None,
) -> tuple[ErrorEllipse, ...]:
    """Return the ellipses of covariances in a frame.

    Args:
        frame: the frame of the covariances.
        pairs: the n places, each with a second one or None.
        centres: where the ellipses lie, in whose horizons they are taken, (n, 3) metres.
        sigma: covariances (n, 3, 3), metres².
        confidence: as in `error_ellipse`.
        redundancy: r of the σ̂0 that scales the covariances; None: σ0 is known.
    """
    plan, _ = _in_horizon(frame, centres, sigma)
    ee, nn, en = plan[:, 0, 0], plan[:, 1, 1], plan[:, 0, 1]
    major = (ee + nn + np.hypot(nn - ee, 2.0 * en)) / 2.0
    # minor = determinant / major avoids the difference of large numbers for thin ellipses.
    determinant = np.maximum(ee * nn - en * en, 0.0)
    minor = np.divide(determinant, major, out=np.zeros_like(major), where=major > 0)
    azimuths = within(np.arctan2(2.0 * en, nn - ee) / 2.0, np.pi).tolist()
    variances = np.stack([np.maximum(major, 0.0), minor], axis=1)
    factors = _factors(variances, confidence, redundancy)
    axes = factors[:, None] * np.sqrt(variances)
    return tuple(
        ErrorEllipse(a, b, centre, (big, small), azimuth, confidence, factor)
        for (a, b), centre, (big, small), azimuth, factor in zip(
            pairs, centres, axes.tolist(), azimuths, factors.tolist(), strict=True
        )
    )


def region_factors(solution: Solution, variances: Array, confidence: float | None) -> Array:
    """Return k (n,) for the number of axes that are not held.

    Args:
        solution: an adjusted network, which gives the scale of the covariances.
        variances: variances along the axes, descending, (n, dim) metres².
        confidence: probability; None for standard ellipses.
    """
    return _factors(variances, confidence, _redundancy_of(solution))


def _factors(variances: Array, confidence: float | None, redundancy: int | None) -> Array:
    rank = np.sum(variances > FIXED_AXIS_VARIANCE_RATIO * variances[:, :1], axis=1)
    every = [
        confidence_factor(k, confidence, redundancy=redundancy)
        for k in range(1, variances.shape[1] + 1)
    ]
    return np.asarray(np.array(every)[np.maximum(rank, 1) - 1])


def _ellipsoids(
    solution: Solution, pairs: PlacePairs, centres: Array, sigma: Array, confidence: float | None
) -> tuple[ErrorEllipsoid, ...]:
    local, enu = _in_horizon(solution.network.frame, centres, sigma)
    values, vectors = np.linalg.eigh((local + local.transpose(0, 2, 1)) / 2.0)
    variances = np.maximum(values[:, ::-1], 0.0)
    factors = region_factors(solution, variances, confidence)
    axes = factors[:, None] * np.sqrt(variances)
    # Rows: axes in east, north, up, longest first, turned so that the azimuth is in [0, π).
    ends = vectors.transpose(0, 2, 1)[:, ::-1]
    east, north, up = ends[..., 0], ends[..., 1], ends[..., 2]
    level = np.hypot(east, north)
    vertical = level < ROUNDING_COMPONENT
    meridian = np.abs(east) < ROUNDING_COMPONENT
    turned = np.where(vertical, up > 0, np.where(meridian, north < 0, east < 0))
    ends = np.where(turned[..., None], -ends, ends)
    azimuths = np.where(meridian, 0.0, np.arctan2(ends[..., 0], ends[..., 1]))
    dips = np.where(vertical, np.pi / 2.0, np.arctan2(-ends[..., 2], level))
    return tuple(
        ErrorEllipsoid(
            a, b, centre, tuple(sizes), tuple(azimuth), tuple(dip), axis, confidence, factor
        )
        for (a, b), centre, sizes, azimuth, dip, axis, factor in zip(
            pairs,
            centres,
            axes.tolist(),
            azimuths.tolist(),
            dips.tolist(),
            ends @ enu,
            factors.tolist(),
            strict=True,
        )
    )
