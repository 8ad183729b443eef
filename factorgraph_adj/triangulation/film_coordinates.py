"""Film coordinates of measured points, with their covariance: by all marks, or by réseau patches.

Where fiducial marks are observations of a network (`FiducialMark`), the interior orientation and
its uncertainty are a part of the adjustment, and nothing of this module is needed. It is for what
happens before an adjustment, or without one:

- a réseau, whose crosses follow the film from patch to patch: each point is transformed by the
  four crosses around it (bilinear, without redundancy) or the nearest five (affine, with tests);
- a comparator, whose affinity and non-orthogonality follow from a grid plate measured in it;
- film deformation, which the residuals of a réseau show.

The transformation is that of `FilmLens`, from the film to what was measured, so that residuals are
those of measured coordinates. Film coordinates q of a point measured at x solve T(q, k) = x, and

    dq = B⁻¹ (dx − K dk),   B = ∂T/∂q,  K = ∂T/∂k,   dk = (JᵀJ)⁻¹ Jᵀ dm

with the measured coordinates m of the marks used and J their partials by k. Points that share marks
are correlated; `FilmCoordinates.covariance` is that of all of them. (FRAMES F15.3, F15.4, F15.6.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ..errors import InputError, Problem
from ..frames import LocalFrame
from ..models.film_lens import (
    FilmLens,
    Transformation,
    fiducial_mark,
    start_of_interior_orientation,
    transformation_parameters,
)
from ..models.inverse_lens import tangents
from ..models.lens import Pair
from ..types import Array, Index

LENS = FilmLens()
ROUNDING = 1e-9
"""Singular value, relative to the largest, below which marks do not determine a parameter."""


@dataclass(frozen=True, eq=False)
class MarkFit:
    """The transformation of some marks, and what their residuals say of it."""

    marks: Index
    """Numbers of the marks, (n,)."""
    parameters: Array
    """Parameters of `FilmLens`, relative to the middle of the marks on the film, (k,)."""
    residuals: Array
    """Computed − measured, (n, 2)."""
    redundancy_numbers: Array
    """r of each coordinate, (n, 2)."""
    sigma: Array
    """Standard deviations of the measured coordinates, (n, 2)."""
    middle: Array
    """Middle of the marks on the film, (2,)."""
    by_marks: Array
    """∂k/∂m of the parameters by the measured coordinates, (k, n, 2)."""

    @property
    def redundancy(self) -> int:
        """Number of coordinates less that of the parameters."""
        return round(float(self.redundancy_numbers.sum()))

    @property
    def sigma0(self) -> float:
        """σ̂0; NaN without redundancy."""
        r = self.redundancy
        return float(np.sqrt(np.sum((self.residuals / self.sigma) ** 2) / r)) if r else np.nan

    @cached_property
    def test_values(self) -> Array:
        """Normalised residuals w = v / (σ √r), (n, 2); NaN where r is zero."""
        w = np.full(self.residuals.shape, np.nan)
        controlled = self.redundancy_numbers > 1e-6
        by = (self.sigma * np.sqrt(np.maximum(self.redundancy_numbers, 0.0)))[controlled]
        w[controlled] = self.residuals[controlled] / by
        return w


@dataclass(frozen=True, eq=False)
class FilmCoordinates:
    """Film coordinates of measured points."""

    xy: Array
    """Coordinates on the film, (m, 2), in the unit of the calibrated marks."""
    covariance: Array
    """Covariance of x and y of all points in turn, (2 m, 2 m), in squares of that unit."""
    fits: tuple[MarkFit, ...]
    """The transformations: one for all points, or those of the patches, each once."""
    fit_of_point: Index
    """Number of the transformation of each point, (m,)."""

    @property
    def sigmas(self) -> Array:
        """Standard deviations of x and y, (m, 2), in the unit of the calibrated marks."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(-1, 2))


def fit_marks(
    film: Array,
    measured: Array,
    *,
    transformation: Transformation = "affine",
    sigma: Array | float = 1.0,
    marks: Index | None = None,
) -> MarkFit:
    """Fit the transformation from the film to measured marks by least squares.

    Args:
        film: calibrated coordinates, (n, 2).
        measured: measured coordinates, (n, 2), of the same marks.
        transformation: the transformation, see `factorgraph_adj.models.film_lens`.
        sigma: standard deviations of measured coordinates in their unit, one or (n, 2).
        marks: numbers that the marks have in the result; None: 0, 1 ….

    Raises:
        InputError: an unknown transformation, marks that do not determine it, or coordinates of
            other shapes.
    """
    names = transformation_parameters(transformation)
    _refuse_other_shapes(film=film, measured=measured)
    n = len(film)
    numbers = np.arange(n) if marks is None else marks
    sigmas = np.broadcast_to(np.asarray(sigma, dtype=float), (n, 2))
    middle = film.mean(axis=0)
    free = np.array([name in names for name in LENS.names])
    values = np.zeros(len(LENS.names))
    values[0] = 1.0
    at = film - middle
    k = start_of_interior_orientation(LENS, values, free, at, measured)
    v, j = _partials(at, measured, k)
    a = (j / sigmas[:, :, None]).reshape(2 * n, -1)[:, free]
    size = np.linalg.norm(a, axis=0)
    scaled = a / np.where(size > 0.0, size, 1.0)
    if 2 * n < len(names) or np.linalg.svd(scaled, compute_uv=False)[-1] < ROUNDING:
        what = (
            f"{n} marks do not determine a transformation that is {transformation}, with "
            f"{len(names)} parameters: it needs {(len(names) + 1) // 2} marks or more, not all "
            "near one line"
        )
        raise InputError(Problem(what, f"marks {', '.join(map(str, numbers.tolist()))}"))
    # Of a projective transformation the partials change with k: weights are part of the fit.
    for _ in range(STEPS):
        step = np.linalg.lstsq(scaled, (v / sigmas).ravel(), rcond=None)[0] / size
        k[free] -= step
        v, j = _partials(at, measured, k)
        a = (j / sigmas[:, :, None]).reshape(2 * n, -1)[:, free]
        scaled = a / size
        if np.abs(step * size).max() < STEP_TOLERANCE:
            break
    inverse = np.linalg.pinv(scaled) / size[:, None]  # k by whitened m
    hat = np.einsum("ij,ji->i", a, inverse).reshape(n, 2)
    by_marks = np.zeros((len(LENS.names), n, 2))
    by_marks[free] = inverse.reshape(-1, n, 2) / sigmas
    return MarkFit(numbers, k, v, 1.0 - hat, sigmas, middle, by_marks)


STEPS = 20
"""Largest number of steps of a fit."""
STEP_TOLERANCE = 1e-10
"""Change of a residual, in its σ, at which a fit ends."""


def _refuse_other_shapes(*, film: Array, measured: Array) -> None:
    """Raise InputError unless every mark has x and y on the film and x and y as measured."""
    shapes = np.shape(film), np.shape(measured)
    if shapes[0] != shapes[1] or len(shapes[0]) != 2 or shapes[0][1] != 2:
        raise InputError(
            "film and measured must be x and y of the same marks, (n, 2), not "
            f"{shapes[0]} and {shapes[1]}"
        )


def _partials(film: Array, measured: Array, k: Array) -> tuple[Array, Array]:
    """Return residuals (n, 2) of marks and their partials by the parameters, (n, 2, k)."""
    x, y = film.T
    found = fiducial_mark(LocalFrame(), k[None], observed=measured, film_x=x, film_y=y, lens=LENS)
    return found.residual, found.jacobians[0]


def film_coordinates(
    film: Array,
    measured: Array,
    xy: Array,
    *,
    transformation: Transformation = "affine",
    reseau: Literal["four", "five"] | None = None,
    sigma_marks: Array | float,
    sigma: float,
) -> FilmCoordinates:
    """Return the film coordinates of points from marks that were measured with them.

    They have the origin, the axes and the unit of ``film``: from the principal point where the
    calibrated coordinates of the marks are.

    Args:
        film: calibrated coordinates of the marks, (n, 2), in the unit of the film: the result has
            it too, with its covariance.
        measured: measured coordinates of the same marks, (n, 2), in the unit of the measurement,
            such as pixels.
        xy: measured coordinates of the points, (m, 2), in the unit of the measurement.
        transformation: the transformation by all marks.
        reseau: the patch of each point instead: ``four`` crosses, the nearest one in each quadrant
            of the film around the point, for a bilinear transformation; or the nearest ``five``,
            for an affine one, whose fit has tests. The patch of a point outside all crosses is at
            the edge, and its transformation is extrapolated.
        sigma_marks: standard deviations of measured marks, in the unit of ``measured``, one or
            (n, 2).
        sigma: standard deviation of measured coordinates of points, in the same unit.

    Raises:
        InputError: an unknown transformation or patch, marks that do not determine it, or
            coordinates of other shapes.
    """
    _refuse_other_shapes(film=film, measured=measured)
    n, m = len(film), len(xy)
    if reseau not in (None, "four", "five"):
        raise InputError(f"unknown patch {reseau!r} of a réseau; valid: four, five")
    sigmas = np.broadcast_to(np.asarray(sigma_marks, dtype=float), (n, 2))
    chosen = [np.arange(n)] * m
    if reseau is not None:
        transformation = "bilinear" if reseau == "four" else "affine"
        chosen = _patches(film, measured, xy, reseau)
    numbers: dict[tuple[int, ...], int] = {}
    fit_of_point = np.array(
        [numbers.setdefault(tuple(c.tolist()), len(numbers)) for c in chosen], dtype=np.intp
    )
    fits = []
    out, by_marks = np.empty((m, 2)), np.zeros((m, 2, n, 2))
    own = np.empty((m, 2, 2))
    for patch, number in numbers.items():
        used = np.array(patch)
        fit = fit_marks(
            film[used],
            measured[used],
            transformation=transformation,
            sigma=sigmas[used],
            marks=used,
        )
        fits.append(fit)
        at = np.flatnonzero(fit_of_point == number)
        q = tangents(LENS, xy[at], fit.parameters[None])  # c is 1: tangents are film coordinates
        _, by_q, by_k = LENS.scanned(q[:, 0], q[:, 1], fit.parameters[None])
        inverse = np.linalg.inv(_stacked(by_q, len(at)))
        out[at] = q + fit.middle
        own[at] = sigma * inverse
        moved = np.einsum("ijk,kab->ijab", _stacked(by_k, len(at)), fit.by_marks[1:])
        by_marks[at[:, None], :, used] = -np.einsum("pij,pjab->paib", inverse, moved)
    flat = (by_marks * sigmas).reshape(2 * m, 2 * n)
    covariance = flat @ flat.T
    for i in range(m):
        here = slice(2 * i, 2 * i + 2)
        covariance[here, here] += own[i] @ own[i].T
    return FilmCoordinates(out, covariance, tuple(fits), fit_of_point)


def _patches(
    film: Array, measured: Array, xy: Array, reseau: Literal["four", "five"]
) -> list[Index]:
    """Return the numbers of the crosses of the patch of each point, in ascending order."""
    whole = fit_marks(film, measured)
    at = tangents(LENS, xy, whole.parameters[None]) + whole.middle
    low, high = film.min(axis=0), film.max(axis=0)
    inside = EDGE * (high - low)
    offset = film[None] - np.clip(at, low + inside, high - inside)[:, None]
    away = np.hypot(offset[:, :, 0], offset[:, :, 1])
    if reseau == "five":
        return [np.sort(row) for row in np.argsort(away, axis=1, kind="stable")[:, :5]]
    quadrant = 2 * (offset[:, :, 0] >= 0.0) + (offset[:, :, 1] >= 0.0)
    out = []
    for own, distance in zip(quadrant, away, strict=True):
        each = [np.flatnonzero(own == q) for q in range(4)]
        out.append(np.sort([int(c[np.argmin(distance[c])]) for c in each if len(c)]))
    return out


EDGE = 1e-6
"""Distance from the outermost crosses, part of their extent, to which points are moved inside."""


def _stacked(pairs: tuple[Pair, ...], m: int) -> Array:
    """Return pairs of partials of m points as one array, (m, 2, number of pairs)."""
    out = np.empty((m, 2, len(pairs)))
    for j, (px, py) in enumerate(pairs):
        out[:, 0, j], out[:, 1, j] = px, py
    return out
