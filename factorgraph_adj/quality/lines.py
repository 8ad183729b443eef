"""Adjusted lines between two places: distance, azimuth, rise, and the relative error ellipse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..models.base import within
from ..network.network import Network
from ..solve.solution import Solution
from ..types import Array
from .ellipses import ErrorEllipse, ellipses_of
from .levels import CONFIDENCE
from .relative import Place, covariance, length_and_sigma, position


@dataclass(frozen=True)
class AdjustedLine:
    """The line from one place to another after the adjustment, from mark to mark."""

    a: Place
    """First place."""
    b: Place
    """Second place."""
    distance: float
    """Slope distance, metres."""
    sigma_distance: float
    """Its standard deviation, metres; zero between held places, NaN for places that coincide."""
    azimuth: float
    """Azimuth at ``a``, clockwise from north, radians in [0, 2π); NaN for a plumb line."""
    sigma_azimuth: float
    """Its standard deviation, radians; NaN for a plumb line."""
    rise: float
    """Height difference b − a along the vertical of the midpoint, metres."""
    sigma_rise: float
    """Its standard deviation, metres."""
    ellipse: ErrorEllipse
    """Relative error ellipse."""

    @property
    def ppm(self) -> float:
        """σ of the distance in parts per million of it."""
        return 1e6 * self.sigma_distance / self.distance if self.distance > 0 else np.nan


def observed_pairs(network: Network) -> list[tuple[Place, Place]]:
    """Return the pairs of points that observations join, in their order, each once.

    An angle joins its station with both of its targets. Pairs of held points are left out.
    """
    found: dict[frozenset[str], tuple[Place, Place]] = {}
    for o in network.observations.values():
        station, *others = o.points() or ("",)
        for target in others:
            held = all(all(network.points[n].fixed) for n in (station, target))
            if station != target and not held:
                found.setdefault(frozenset((station, target)), (station, target))
    return list(found.values())


@with_one_thread
def adjusted_lines(
    solution: Solution,
    pairs: Sequence[tuple[Place, Place]] | None = None,
    *,
    confidence: float | None = CONFIDENCE,
) -> tuple[AdjustedLine, ...]:
    """Return adjusted distances, azimuths and rises between places with relative error ellipses.

    With d = X_b − X_a, Σ_Δ its covariance with all cross-covariances, e, n, u the horizon at a and
    u' the vertical of the midpoint:

        distance |d|             σ² = dᵀ Σ_Δ d / |d|²
        azimuth atan2(e·d, n·d)  σ² = tᵀ Σ_Δ t / s², t = e cos α − n sin α, s² = (e·d)² + (n·d)²
        rise u'·d                σ² = u'ᵀ Σ_Δ u'

    Shifts of the datum cancel in all of them on a plane. In curved frames the turn of the
    verticals with the datum, of the order of s/R, is left out of σ of azimuth and rise.

    Args:
        solution: an adjusted network.
        pairs: pairs of places: names of points, or ``("pose", name)`` for projection centres;
            None: the pairs that observations join.
        confidence: probability of the ellipses; None: standard ellipses.

    Raises:
        InputError: unknown names, two identical places, confidence outside (0, 1).
    """
    every = observed_pairs(solution.network) if pairs is None else list(pairs)
    sigma = np.array([covariance(solution, a, b) for a, b in every]).reshape(-1, 3, 3)
    start = np.array([position(solution, a) for a, _ in every]).reshape(-1, 3)
    end = np.array([position(solution, b) for _, b in every]).reshape(-1, 3)
    centre, d = (start + end) / 2.0, end - start
    ellipses = ellipses_of(solution, list(every), centre, sigma, confidence)
    azimuths, sigma_azimuths = _azimuths(_horizon(solution, start), d, sigma)
    up = _horizon(solution, centre)[:, 2]
    rises = np.einsum("ni,ni->n", up, d)
    sigma_rises = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", up, sigma, up), 0.0))
    out = []
    for i, (a, b) in enumerate(every):
        distance, sigma_distance = length_and_sigma(d[i], sigma[i])
        azimuth, sigma_azimuth = float(azimuths[i]), float(sigma_azimuths[i])
        rise, sigma_rise = float(rises[i]), float(sigma_rises[i])
        figures = (distance, sigma_distance, azimuth, sigma_azimuth, rise, sigma_rise)
        out.append(AdjustedLine(a, b, *figures, ellipses[i]))
    return tuple(out)


def _horizon(solution: Solution, at: Array) -> Array:
    """Return east, north, up of positions (n, 3) as rows (n, 3, 3)."""
    return solution.network.frame.basis(at, np.zeros((len(at), 2))).enu


def _azimuths(enu: Array, d: Array, sigma: Array) -> tuple[Array, Array]:
    """Return azimuths (n,) and their standard deviations; NaN for plumb lines."""
    east, north = (np.einsum("ni,ni->n", enu[:, i], d) for i in (0, 1))
    level = np.hypot(east, north)
    there = level > 0
    azimuth = np.where(there, within(np.arctan2(east, north)), np.nan)
    across = enu[:, 0] * np.cos(azimuth)[:, None] - enu[:, 1] * np.sin(azimuth)[:, None]
    variance = np.einsum("ni,nij,nj->n", across, sigma, across)
    safe = np.where(there, level, 1.0)
    return azimuth, np.sqrt(np.maximum(variance, 0.0)) / safe
